"""The state machine as one table: PackML's 17 states and 9 commands (ISA-TR88.00.02).

It departs from the standard in two places. A hold is possible from Completing, too, because the delivery is motion, and
Unholding leads back to the state of the hold. And there is a tenth command, ``pick``: a start of one cycle.

An invalid command is refused with its reason and the available commands, never ignored. One thread owns the machine.
"""

from __future__ import annotations

import re
from enum import StrEnum

from bus.commands import UnitMode
from bus.errors import Refused
from bus.messages.approval import Decision


class State(StrEnum):
    """PackML state names; *acting* states run an action and end by themselves, the others wait."""

    STOPPED = "Stopped"
    RESETTING = "Resetting"
    IDLE = "Idle"
    STARTING = "Starting"
    EXECUTE = "Execute"
    HOLDING = "Holding"
    HELD = "Held"
    UNHOLDING = "Unholding"
    SUSPENDING = "Suspending"
    SUSPENDED = "Suspended"
    UNSUSPENDING = "Unsuspending"
    COMPLETING = "Completing"
    COMPLETE = "Complete"
    STOPPING = "Stopping"
    ABORTING = "Aborting"
    ABORTED = "Aborted"
    CLEARING = "Clearing"


SETTLED = frozenset({State.STOPPED, State.IDLE, State.COMPLETE, State.ABORTED})
"""States in which nothing moves, and no commanded action continues."""
ENDED = frozenset({State.STOPPED, State.ABORTED})
"""Settled states in which a pick that had begun is over for good."""
READY = SETTLED - ENDED
"""Settled states in which a pick can begin."""

NEXT: dict[State, State] = {
    State.RESETTING: State.IDLE,
    State.STARTING: State.EXECUTE,
    State.EXECUTE: State.COMPLETING,
    State.HOLDING: State.HELD,
    State.UNHOLDING: State.EXECUTE,
    State.SUSPENDING: State.SUSPENDED,
    State.UNSUSPENDING: State.EXECUTE,
    State.COMPLETING: State.COMPLETE,
    State.STOPPING: State.STOPPED,
    State.ABORTING: State.ABORTED,
    State.CLEARING: State.STOPPED,
}
"""The state that follows an acting state; from Unholding it is Completing when the hold came from there."""

PAUSED = frozenset({State.HELD, State.SUSPENDED})
"""States in which nothing moves until somebody lets it go on."""
PAUSING = frozenset({State.HOLDING, State.SUSPENDING})
GOING_ON = frozenset({State.UNHOLDING, State.UNSUSPENDING})
PAUSES = PAUSING | PAUSED | GOING_ON
"""States of a pause, in which the action of the held or suspended state is still open."""

BEGINNING = frozenset({State.RESETTING, State.STARTING, State.CLEARING})
"""States that begin something new; not entered while a stopped action still runs."""

ENDING = frozenset({"stop", "abort", "hold", "suspend"})
"""Commands that bring motion to rest."""

ANSWERS: tuple[Decision, ...] = ("approve", "next_grasp", "reject")
"""Commands that answer a proposal, in Execute while the stage is ``approve``; like ``cancel`` they change no state."""
MANUAL_MOTIONS = ("jog", "jog_home", "hand_open", "hand_close")
"""Motions by hand: in mode Manual, while the cell is Stopped."""
BESIDE = ("cancel", *ANSWERS, "mode", *MANUAL_MOTIONS)
"""Commands beside the table."""

_UNSTOPPABLE = {State.STOPPING, State.STOPPED, State.CLEARING, State.ABORTING, State.ABORTED}
_ABORT_FROM = set(State) - {State.ABORTING, State.ABORTED}

COMMANDS: dict[str, dict[State, State]] = {
    "reset": {State.STOPPED: State.RESETTING, State.COMPLETE: State.RESETTING},
    "start": {State.IDLE: State.STARTING},
    "pick": {State.IDLE: State.STARTING, State.COMPLETE: State.RESETTING},
    "stop": dict.fromkeys(set(State) - _UNSTOPPABLE, State.STOPPING),
    "abort": dict.fromkeys(_ABORT_FROM, State.ABORTING),
    "hold": {State.EXECUTE: State.HOLDING, State.COMPLETING: State.HOLDING},
    "unhold": {State.HELD: State.UNHOLDING},
    "suspend": {State.EXECUTE: State.SUSPENDING},
    "unsuspend": {State.SUSPENDED: State.UNSUSPENDING},
    "clear": {State.ABORTED: State.CLEARING},
}
"""Command -> {from: to}. ``pick`` after a completed cycle resets first. Hold is for a reason of the operator or the
cell,
Suspend for one outside of the cell; both brake on the path and wait."""
VERBS = (*COMMANDS, *BESIDE)
"""Every command that a cell takes, in some state or mode."""

_NEEDLESS = {
    "stop": "Nothing moves any more.",
    "abort": "It is aborted already, or about to be.",
    "hold": "Only a cycle that runs can be held.",
    "unhold": "No cycle is held.",
    "suspend": "Only a cycle that runs can be suspended.",
    "unsuspend": "No cycle is suspended.",
    "clear": "Only an aborted cell is cleared.",
}
"""Refusals of commands that have nothing to act on."""
_HOW_TO_GET_READY = {
    State.STOPPED: "Reset the cell first: `cell reset`.",
    State.IDLE: "It is ready: `cell pick`, `cell run`.",
    State.COMPLETE: "Reset the cell first: `cell reset`; or ask for one pick: `cell pick`.",
    State.ABORTED: "Three deliberate acts: `cell clear`, `cell reset`, then start.",
    State.EXECUTE: "A cycle is running: wait for it, send a job with queue, or `cell stop`.",
    State.HELD: "A cycle is held: `cell unhold`, or `cell stop`.",
    State.SUSPENDED: "A cycle is suspended: `cell unsuspend`, or `cell stop`.",
}


PRODUCTION_ONLY = frozenset({"reset", "start", "pick"})
"""Commands that mode Manual refuses."""
MODE_FROM = SETTLED
"""States in which the mode can change; to Manual, it stops the cell."""


def available(state: State, stage: str = "", mode: UnitMode = "Production") -> tuple[str, ...]:
    """Return the commands that are accepted in ``state``, in table order.

    Args:
        stage: of the running cycle. ``mode``: of the unit.
    """
    commands = tuple(command for command, arrows in COMMANDS.items() if state in arrows)
    if mode == "Manual":
        moves = (*MANUAL_MOTIONS, "stop") if state is State.STOPPED else ()
        return (*(command for command in commands if command not in PRODUCTION_ONLY), *moves, "mode")
    return (*commands, *ANSWERS) if state is State.EXECUTE and stage == "approve" else commands


def require_answerable(verb: str, state: State) -> None:
    """Refuse to answer a proposal in another state than Execute: in a pause no answer counts. Raises: Refused."""
    if state is not State.EXECUTE:
        raise Refused(
            f"{verb!r} is not possible while the cell is {state}.",
            _HOW_TO_GET_READY.get(state, "Wait for a cycle that asks: its stage is `approve`."),
            code="WRONG_STATE",
            available=available(state),
        )


def after_command(state: State, command: str) -> State:
    """Return the state that ``command`` leads to from ``state``. Raises: Refused when it is unknown or unavailable."""
    arrows = COMMANDS.get(command)
    if arrows is None:
        raise Refused(
            f"There is no command {command!r}.",
            f"Commands: {', '.join(VERBS)}.",
            code="UNKNOWN_COMMAND",
            available=available(state),
        )
    if state not in arrows:
        advice = _NEEDLESS.get(command) or _HOW_TO_GET_READY.get(state, "Wait until that is over.")
        if command in ("pick", "start") and state not in _HOW_TO_GET_READY:
            advice = "Wait until that is over, or send the job with queue: it waits for its turn."
        advice += f" Available now: {', '.join(available(state)) or 'nothing'}."
        raise Refused(
            f"{command!r} is not possible while the cell is {state}.",
            advice,
            code="WRONG_STATE",
            available=available(state),
        )
    return arrows[state]


_COMMAND = re.compile(r"command '(?:stop|abort|hold|suspend)' from (a client|\S+)( .+)?")


def told(state: str, reason: str) -> str:
    """Return the state for a person, with the client that brought it to rest: ``Stopped by ann-4711``."""
    found = _COMMAND.fullmatch(reason)
    if not found:
        return reason
    return f"{state} by {found[1]}" + (f".{found[2]}" if found[2] else "")
