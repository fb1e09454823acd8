"""The items that the machine's owner thread takes, one at a time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

from bus.commands import CommandReply, CommandRequest
from bus.errors import CellError, CycleFailure
from cell.machine.states import State


@dataclass(frozen=True)
class Command:
    """A command of a client or of the cell itself; ``reason``: said with the state that it leads to."""

    verb: str
    request: CommandRequest
    reply: Future[CommandReply]
    reason: str


@dataclass(frozen=True)
class Run:
    """One run of an acting state's action."""

    number: int
    state: State


@dataclass(frozen=True)
class Done:
    """The end of a run; ``error``: None after success."""

    run: Run
    error: CellError | None


@dataclass(frozen=True)
class Fault:
    """A failure outside any action; ``is_defect``: of the cell's own process."""

    failure: CycleFailure
    is_defect: bool = False


@dataclass(frozen=True)
class Act:
    """A decision for the owner thread, between two commands."""

    act: Callable[[], None]


Item = Command | Done | Fault | Act
