"""The messages of a cell while it works, heard and in words."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bus import topics
from bus.codec import decode
from bus.commands import CellState, Event
from bus.errors import BadPayload, CellError, CellUnreachable
from bus.messages import CycleResult
from bus.sample import Sample
from cell.client import Client

Said = CellState | Event | CycleResult
"""A state or stage at every change, an event for a person, a cycle's result."""
LOOK_S = 0.5
"""Time without a message after which the cell is asked: one may have been lost."""
GRACE_S = 5.0
"""How much later than the rest of a stopped cell a result may come."""
_KINDS: dict[str, Any] = {topics.STATE.key: CellState, topics.EVENT.key: Event, topics.RESULT.key: CycleResult}


def in_words(said: Said) -> str:
    """A line for a person; "" for what needs none."""
    if isinstance(said, CellState):
        return f"{said.state} {said.stage}".strip()
    if isinstance(said, Event):
        return f"{said.code}: {said.text} {said.advice}".strip()
    return " ".join(filter(None, (said.result, said.code, said.object))) + f": {said.reason}"


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


def next_message(client: Client, timeout_s: float = 600.0) -> Said | None:
    """Return the next state, event or result; None after so long without one. Raises: CellUnreachable."""
    while (sample := client.next_heard(timeout_s)) is not None:
        if (said := _decoded(sample)) is not None:
            return said
    if client.is_gone:
        raise CellUnreachable("The cell is gone: it ended, or the link to it.", "Start it, then see `cell cycles`.")
    return None


def _decoded(sample: Sample) -> Said | None:
    kind: Any = _KINDS.get(sample.key)
    try:
        said: Said | None = decode(kind, sample.payload) if kind is not None else None
    except BadPayload:  # of another version; states and results are asked for anyway
        return None
    return said
