"""What a cell says while it works, in words, and a program that waits for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bus.codes import title_of
from bus.commands import CellState, Event
from bus.errors import CellError
from cell.client import Client
from cell.following import Said


def in_words(said: Said) -> str:
    """A line for a person; "" for what needs none."""
    if isinstance(said, CellState):
        return f"{said.state} {said.stage}".strip()
    if isinstance(said, Event):
        return f"{said.code}: {said.text} {said.advice}".strip()
    return f"{title_of(said.result, said.code or '', said.object)}: {said.reason}"


@contextmanager
def attended(client: Client) -> Iterator[None]:
    """Context of a program that waits for motion: what cuts the wait off leaves nobody who attends it.

    After Ctrl-C, or an error of the program's own (in ``progress``), the lease is given back, and the cell holds the
    motion. Without this a notebook, which lives on, would keep the arm moving. An error of the cell says itself what
    becomes of the motion.
    """
    try:
        yield
    except CellError:
        raise
    except BaseException:
        client.release()
        raise
