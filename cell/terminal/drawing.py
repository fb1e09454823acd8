"""Tables, the live view and a progress bar; their text is untrusted, as in `cell.terminal.printing`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from cell.terminal.printing import Part, Printer, plain

ItemT = TypeVar("ItemT")


def words(*parts: Part, style: str = "") -> Text:
    """Text of all parts, made `plain`; ``style`` applies to those without their own."""
    texts = [part if isinstance(part, tuple) else (part, style) for part in parts]
    return Text.assemble(*((plain(text), its) for text, its in texts))


def console(printer: Printer, width: int | None = None) -> Console:
    """A rich console on ``printer``; strings are not parsed as markup. ``width`` [columns]: None = the terminal's."""
    return Console(file=printer, markup=False, emoji=False, highlight=False, width=width)  # type: ignore[arg-type]


def tracked(items: Iterable[ItemT], total: int, what: str, printer: Printer) -> Iterator[ItemT]:
    """Yield the items, with a progress bar when ``printer`` is a terminal."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    canvas = console(printer)
    with Progress(*columns, console=canvas, transient=True, disable=not canvas.is_terminal) as progress:
        yield from progress.track(items, total=total, description=plain(what))


def table(columns: Sequence[str], *, expand: bool = False, right: Sequence[str] = ()) -> Table:
    """An empty table without lines; cells are cut, not wrapped. ``right``: the right-aligned columns."""
    made = Table(box=None, pad_edge=False, expand=expand, header_style="dim")
    for name in columns:
        made.add_column(name, no_wrap=True, overflow="ellipsis", justify="right" if name in right else "left")
    return made
