"""The tour does not wait for a cell that has ended."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bus.commands import CellState, CommandReply, CommandRequest
from bus.errors import NotReached
from cell.cli.serving import tour
from cell.daemon.daemon import Daemon

ACCEPTS = cast(Daemon, SimpleNamespace(command=lambda *_: CommandReply(ok=True, state="", cycle_id="c")))
LOST = "DEVICE_LOST The camera is gone."


def _says(*states: str) -> Iterator[CellState]:
    """The states of a cell that would then say nothing for ever."""
    for state in states:
        yield CellState(state=state, stage="", cycle_id="", since_ns=0, available=(), reason=LOST)
    pytest.fail("It waits for more.")


def test_a_cell_that_aborts_ends_the_tour_with_the_reason() -> None:
    with pytest.raises(NotReached, match=LOST):
        tour._reset(ACCEPTS, _says("Stopped", "Resetting", "Aborting", "Aborted"))
    with pytest.raises(NotReached, match=LOST):
        tour._pick(ACCEPTS, _says("Starting", "Aborting", "Aborted"), CommandRequest())


def test_that_the_cell_was_stopped_before_the_reset_is_no_end() -> None:
    heard: Any = _says("Stopped", "Resetting", "Idle")
    tour._reset(ACCEPTS, heard)
