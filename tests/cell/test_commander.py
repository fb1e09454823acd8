"""A commander has a connection, and with it a lease, as long as there is motion to attend; not shorter, not longer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

import pytest

from bus.commands import CellState, CommandReply, CommandRequest
from bus.errors import Refused
from cell.client import Client
from cell.commander import Commander


def _state(name: str, since_ns: int, job_id: str = "") -> CellState:
    return CellState(state=name, stage="", cycle_id="", since_ns=since_ns, available=(), reason="", job_id=job_id)


class Cell:
    """Accepts every command, with the state that a test set."""

    def __init__(self) -> None:
        self.now = _state("Stopped", 1)
        self.open = 0

    @contextmanager
    def connect(self) -> Iterator[Client]:
        self.open += 1
        yield cast(Client, self)
        self.open -= 1

    def send(self, _verb: str, _request: CommandRequest) -> CommandReply:
        return CommandReply(ok=True, state=self.now.state, since_ns=self.now.since_ns)


@pytest.fixture
def cell() -> Cell:
    return Cell()


def test_it_is_over_with_a_state_of_rest_after_the_command(cell: Cell) -> None:
    commander = Commander(cell.connect)
    cell.now = _state("Starting", 5, "job")
    commander.command("pick")
    for state, is_over in (
        (_state("Idle", 4), False),  # from before the command
        (_state("Execute", 6, "job"), False),
        (_state("Complete", 7, "job"), False),  # another pick of the job follows
        (_state("Complete", 7).model_copy(update={"queue": ("next",)}), False),
        (_state("Complete", 8), True),
    ):
        assert commander.is_over(state, is_gone=False) is is_over, state
    assert commander.is_over(None, is_gone=True)


def test_a_state_of_before_the_last_command_does_not_end_its_lease(cell: Cell) -> None:
    """The state is looked at on one thread, and the connection closed on another: meanwhile a command may be sent."""
    commander, before = Commander(cell.connect), _state("Stopped", 3)
    cell.now = _state("Stopped", 3)
    commander.command("stop")
    assert commander.is_over(before, is_gone=False)
    cell.now = _state("Resetting", 4)
    commander.command("reset")
    commander.release_if_over(before, is_gone=False)
    assert (commander.is_open, cell.open) == (True, 1)
    commander.release_if_over(_state("Idle", 5), is_gone=False)
    assert (commander.is_open, cell.open) == (False, 0)


def test_after_its_end_it_commands_nothing(cell: Cell) -> None:
    commander = Commander(cell.connect)
    commander.command("reset")
    commander.end()
    assert cell.open == 0
    with pytest.raises(Refused, match="Nobody attends"):
        commander.command("reset")
    assert cell.open == 0
