"""Writes docs/settings.md from config/schema.py and its parts: ``uv run python -m docs.settings_page``."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from config.schema import Station
from docs.fields import Row, lead, rows

PAGE = Path(__file__).with_name("settings.md")
_UNITS = {
    "nm_rad": "Nm/rad",
    "kg_m2": "kg m²",
    "m_s": "m/s",
    "rad_s": "rad/s",
    "rad_s2": "rad/s²",
    "rad_s3": "rad/s³",
    "usd_per_million_input_tokens": "USD",
    "usd_per_million_output_tokens": "USD",
    "usd_per_image": "USD",
    "usd": "USD",
    "days": "d",
    "deg": "°",
    "rad": "rad",
    "gb": "GB",
    "mb": "MB",
    "ms": "ms",
    "mm": "mm",
    "kg": "kg",
    "nm": "Nm",
    "px": "px",
    "m": "m",
    "n": "N",
    "s": "s",
}
"""By the end of a setting's name; the longest that fits counts."""


def page() -> str:
    """The page's text."""
    return "\n".join([_HEAD, *_tables("", Station), ""])


def _tables(path: str, model: type[BaseModel], given: BaseModel | None = None) -> Iterator[str]:
    """The section of one table of the file, and of those inside it; ``given``: its default, if it has one."""
    own = [row for row in rows(model, _shown, given) if row.name not in _inner(model)]
    yield from (f"## {_title(path)}", "", lead(model), "")
    if given is not None and any(row.default is None for row in rows(model, _shown)):
        yield from ("A file that has this table gives all of it.", "")
    if own:
        yield from ("| setting | type | default | unit | meaning |", "|---|---|---|---|---|", *map(_row, own), "")
    for name, (below, form) in _inner(model).items():
        inner = form.format(f"{path.strip('[]')}.{name}".lstrip("."))
        default = model.model_fields[name].default
        yield from _tables(inner, below, default if isinstance(default, BaseModel) else None)


def _inner(model: type[BaseModel]) -> dict[str, tuple[type[BaseModel], str]]:
    """The tables inside a table: what each is of, and how its head is written."""
    found = {}
    for name, field in model.model_fields.items():
        kind, form = _without_none(field.annotation), "[{}]"
        if get_origin(kind) is dict:
            kind, form = get_args(kind)[1], "[{}.NAME]"
        elif get_origin(kind) is tuple and get_args(kind)[1:] == (...,):
            kind, form = get_args(kind)[0], "[[{}]]"
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            found[name] = (kind, form)
    return found


def _without_none(kind: Any) -> Any:
    """The one type of ``TYPE | None``."""
    kinds = [one for one in get_args(kind) if one is not NoneType] if get_origin(kind) is UnionType else []
    return kinds[0] if len(kinds) == 1 else kind


def _title(path: str) -> str:
    return f"`{path}`" if path else "At the top of the file"


def _row(row: Row) -> str:
    kind = f"{row.type}, {row.limits}" if row.limits else row.type
    default = "required" if row.default is None else "none" if row.default == "null" else f"`{row.default}`"
    return f"| `{row.name}` | {kind} | {default} | {unit(row.name)} | {row.text} |"


def unit(name: str) -> str:
    """The unit that a setting's name ends with, or ""."""
    fitting = [end for end in _UNITS if f"_{name}".endswith(f"_{end}")]
    return _UNITS[max(fitting, key=len)] if fitting else ""


def _shown(kind: Any) -> str:
    return " or ".join(f"`{one.value}`" for one in kind) if issubclass(kind, Enum) else str(kind.__name__)


_HEAD = """\
# Settings

<!-- Written by docs/settings_page.py from config/schema.py; do not edit. -->

A station is one TOML file: `cell start --config FILE.toml`. What it leaves out has the default below; an unknown key is
an error. `--set key=value` overrides one setting, as in `--set sim.pace=1` or `--set perception.target.text="the cup"`.
[config/sim.toml](../config/sim.toml) is the smallest file; [config/lab.toml](../config/lab.toml) says for real devices
how to find each value.

| what you want | command |
|---|---|
| a new file, with only what one must decide | `cell config new mine.toml` (`--simulated`, `--bin`) |
| is it right? every mistake with its line and what to do | `cell config check mine.toml` |
| what counts, and where it comes from | `cell config show -c mine.toml`; only that: `cell config show verify` |
| what differs from another | `cell config diff a.toml b.toml` |
| an editor that knows every setting | `cell config schema > station.schema.json`; `#:schema` of `--help` |
| does it fit this machine and its devices? | `cell doctor -c mine.toml` |

A list is written `[0.1, 0.2]`; `3 x number` is one of three numbers. A setting whose default is *none* is left out to
have none. Frames: [frames.md](frames.md).
"""

if __name__ == "__main__":
    PAGE.write_text(page())
