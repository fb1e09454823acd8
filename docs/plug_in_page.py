"""Writes docs/plug_ins.md, what a plug-in imports, from its docstrings: ``uv run python -m docs.plug_in_page``."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from config.field_docs import meanings, summary
from docs.fields import lead, markdown, rows
from docs.plug_in_imports import SECTIONS, Section

PAGE = Path(__file__).with_name("plug_ins.md")
_ELSEWHERE = {
    "Code": "its values and what each means: [bus.md](bus.md#codes-of-a-cycle)",
    "Station": "the station file's tables as attributes, e.g. `station.hand.max_width_m`: [settings.md](settings.md)",
}


def page() -> str:
    """The page's text."""
    parts = [_HEAD]
    told: set[str] = set()
    for section in SECTIONS:
        parts.append(f"## {section.title}")
        parts.append("```python\n" + "\n".join(_imports(section)) + "\n```")
        for module, names in section.imports.items():
            parts += [_of(module, name) for name in names if name not in told]
            told |= set(names)
    return "\n\n".join(parts) + "\n"


def _imports(section: Section) -> Iterator[str]:
    for module, names in section.imports.items():
        line = f"from {module} import {', '.join(names)}"
        yield (
            line
            if len(line) <= 110
            else "\n    ".join([f"from {module} import (", *(f"{one}," for one in names)]) + "\n)"
        )


def _of(module: str, name: str) -> str:
    """Return what is said of one name: its sentences, its fields, its methods."""
    what = getattr(import_module(module), name)
    if name in _ELSEWHERE:
        return f"### {name}\n\n{_ELSEWHERE[name][0].upper()}{_ELSEWHERE[name][1:]}."
    if not inspect.isclass(what):
        return _function(name, what) if inspect.isfunction(what) else f"### {name}\n\n`{name} = {what!r}`"
    if issubclass(what, Enum):
        return f"### {name}\n\n{markdown(_doc(what))}\n\n" + ", ".join(f"`{one.name}`" for one in what)
    if issubclass(what, Exception) and name != "CycleFailure":
        made = f"`{name}(text, advice)`, a `{what.__mro__[1].__name__}`; text: what happened, advice: what to do."
        return f"### {name}\n\n{made} {markdown(_doc(what))}"
    shown = [f"### {name}", _lead(what)]
    if table := [*_fields(what)]:
        shown.append("\n".join(["| field | type | default | what |", "|---|---|---|---|", *table]))
    shown += [_method(member, value) for member, value in _methods(what)]
    return "\n\n".join(part for part in shown if part)


def _lead(what: type) -> str:
    text = lead(what) if issubclass(what, BaseModel) else markdown(summary(what))
    made = "" if is_dataclass(what) or issubclass(what, BaseModel) or _is_protocol(what) else _signature(what)
    return f"`{what.__name__}{made}` {text}" if made and not _is_suite(what) else text


def _fields(what: type) -> Iterator[str]:
    """A row for each field of a message, a dataclass or a protocol, and each property."""
    if _is_suite(what):  # docs/extend.md says what is set in one
        return
    if issubclass(what, BaseModel):
        for row in rows(what, _named):
            default = "must be given" if row.default is None else f"`{row.default}`"
            kind = row.type.replace("PNG image", "array")
            yield f"| `{row.name}` | {kind} | {default} | {row.text}{f' ({row.limits})' if row.limits else ''} |"
        return
    texts, kinds = meanings(what), inspect.get_annotations(what)
    defaults = {one.name: one.default for one in fields(what)} if is_dataclass(what) else {}
    for name in [one for one in kinds if one in texts or one in defaults]:
        given = defaults.get(name, MISSING)
        default = "must be given" if given is MISSING else f"`{given!r}`"
        yield f"| `{name}` | {_type(kinds[name])} | {default} | {markdown(texts.get(name, ''))} |"
    for name, member in vars(what).items():
        if isinstance(member, property | cached_property) and not name.startswith("_"):
            read = member.fget if isinstance(member, property) else member.func
            kind = inspect.signature(read).return_annotation  # type: ignore[arg-type]
            yield f"| `{name}` | {_type(kind)} | is computed | {markdown(_doc(member))} |"


def _methods(what: type) -> Iterator[tuple[str, Any]]:
    if _is_suite(what) or issubclass(what, Exception):
        return
    for name, member in vars(what).items():
        value = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        is_ours = inspect.isfunction(value) and value.__module__ == what.__module__
        if is_ours and not name.startswith("_") and value.__doc__:
            yield name, value


def _method(name: str, value: Any) -> str:
    return f"- **`{name}{_signature(value)}`** {markdown(_doc(value))}"


def _function(name: str, what: Any) -> str:
    return f"### {name}\n\n```python\n{name}{_signature(what)}\n```\n\n{markdown(_doc(what))}"


def _signature(what: Any) -> str:
    shown = inspect.signature(what)
    kept = [one for one in shown.parameters.values() if one.name not in ("self", "cls")]
    text = str(shown.replace(parameters=kept)).replace("'", "")
    return _plain(text.removesuffix(" -> None"))


def _type(kind: Any) -> str:
    return f"`{_plain(kind if isinstance(kind, str) else getattr(kind, '__name__', str(kind)))}`".replace("|", "\\|")


def _plain(text: str) -> str:
    """An annotation without its modules."""
    return re.sub(r"\b(?:npt?|bus|config|perception)\.(?:\w+\.)*(?=\w)", "", text)


def _named(kind: type) -> str:
    return f"`{kind.__name__}`"


def _is_protocol(what: type) -> bool:
    return bool(getattr(what, "_is_protocol", False))


def _is_suite(what: type) -> bool:
    return what.__name__.endswith("Suite")


def _doc(what: Any) -> str:
    """A docstring on one line."""
    return " ".join(inspect.cleandoc(what.__doc__ or "").split())


_HEAD = """\
# What a plug-in imports

<!-- Written by docs/plug_in_page.py from the docstrings; do not edit. -->

All that a driver, a detector or a goal-image model gets, returns, raises and may call, with its fields. How to make one
is in [extend.md](extend.md). Poses, axes and units: [frames.md](frames.md). `(H, W)` is rows and columns of a picture;
`(4, 4)` a pose: `base_from_tcp` takes points of the tcp to `base`. Messages are made with their fields by name, and
cannot be changed afterwards."""

if __name__ == "__main__":
    PAGE.write_text(page())
