"""Writes the tables of docs/opcua.md from those of cell/opcua: ``uv run python -m docs.opcua_page``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from cell.opcua.methods import METHODS, Argument
from cell.opcua.refusals import STATUS_NAMES
from cell.opcua.variables import EVENTS, VARIABLES

PAGE = Path(__file__).with_name("opcua.md")


def page() -> str:
    """The page's text, with every table as it is now."""
    text = PAGE.read_text()
    for name, rows in (
        ("variables", _variables()),
        ("events", _events()),
        ("methods", _methods()),
        ("refusals", _refusals()),
    ):
        mark = f"<!-- {name} -->"
        head, rest = text.split(f"{mark}\n")
        rest = re.sub(r"\A\n(\|.*\n)+", "", rest)
        text = "\n".join([f"{head}{mark}", "", *rows, rest])
    return text


def _variables() -> Iterator[str]:
    yield from ("| variable | type | what |", "|---|---|---|")
    for one in VARIABLES:
        ours = "" if one.is_packml else " *ours*"
        kind = {"Count": "PackMLCountDataType", "Alarm": "PackMLAlarmDataType"}.get(one.kind.removesuffix("[]"))
        array = "[]" if one.kind.endswith("[]") else ""
        yield f"| `{one.path}`{ours} | {kind + array if kind else one.kind} | {one.meaning} |"


def _events() -> Iterator[str]:
    yield from ("| event | its own fields |", "|---|---|")
    yield from (f"| `{kind}` | {', '.join(f'`{name}`' for name in fields)} |" for kind, fields in EVENTS.items())


def _methods() -> Iterator[str]:
    yield from ("| method | takes | returns | what |", "|---|---|---|---|")
    for one in METHODS:
        yield f"| `{one.name}` | {_arguments(one.inputs)} | {_arguments(one.outputs)} | {one.meaning} |"


def _arguments(arguments: Iterable[Argument]) -> str:
    return ", ".join(f"`{one.name}` {one.kind}" for one in arguments) or "-"


def _refusals() -> Iterator[str]:
    yield from ("| status | codes |", "|---|---|")
    for status in dict.fromkeys(STATUS_NAMES.values()):
        yield f"| `{status}` | {', '.join(f'`{code}`' for code, name in STATUS_NAMES.items() if name == status)} |"


if __name__ == "__main__":
    PAGE.write_text(page())
