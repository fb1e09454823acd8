"""A real machine and the control of its batches, without devices: for tests of what comes in which order."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

from bus.commands import CommandRequest
from bus.messages import Attempt, CycleResult
from cell.daemon.actions import Actions
from cell.daemon.batch_control import BatchControl
from cell.daemon.publisher import Publisher
from cell.machine.hold_state import HoldState
from cell.machine.owner import Machine
from cell.machine.states import PAUSES, State
from cell.pick.approving import Approvals
from config.load import load_station

OPERATOR = CommandRequest(client_id="op")
SETTLED = {State.STOPPED, State.IDLE, State.COMPLETE, State.ABORTED, State.HELD, State.SUSPENDED}


@dataclass
class _Actions:
    """The part of the actions that `BatchControl` and the machine use: motions through a real gate, without devices."""

    hold_state: HoldState = field(default_factory=HoldState)
    result: str = "SUCCESS"
    laid: Counter[str] = field(default_factory=Counter)
    begun: list[str] = field(default_factory=list)
    cycle_id: str = "c"
    goes_on: threading.Event = field(default_factory=threading.Event)
    at_gate: int = 0
    approvals: Approvals = field(default_factory=Approvals)
    pick: Callable[[], None] | None = None

    @property
    def table(self) -> Any:
        return self

    def require_possible(self, _request: CommandRequest) -> None: ...

    def restart_attempts(self, attempt: Attempt | None = None, *_: Any, **__: Any) -> None:
        if attempt is not None:
            self.begun.append(attempt.job.job_id)

    def take_hold_after_failures(self) -> str:
        return ""

    def __post_init__(self) -> None:
        self.goes_on.set()

    def move(self) -> None:
        """A motion that lasts until `goes_on` is set."""
        self.at_gate += 1
        with self.hold_state.gate.motion():
            self.at_gate -= 1
            assert self.goes_on.wait(60)


class _Publisher:
    def __init__(self) -> None:
        self.states: list[tuple[State, str]] = []
        self.events: list[str] = []

    def publish_state(self, state: State, reason: str) -> None:
        self.states.append((state, reason))

    def publish_event(self, *said: str) -> None:
        self.events.append(" ".join(said))

    def publish_jobs(self) -> None: ...


class Bench:
    """A real machine and its control.

    Args:
        before: called with every command that the cell gives itself, just before.
        options: of the station.
    """

    def __init__(self, before: Callable[[str], None] = lambda verb: None, *options: str) -> None:
        self.actions, self.publisher = _Actions(), _Publisher()
        self.batches = BatchControl(
            cast(Actions, self.actions),
            cast(Publisher, self.publisher),
            load_station(None, options),
            reaches=lambda place_m: place_m[0] < 0.8,
        )
        still = lambda: None  # noqa: E731
        moves = self.actions.move
        self.machine = Machine(
            {
                State.RESETTING: moves,
                State.STARTING: still,
                State.EXECUTE: lambda: (self.actions.pick or moves)(),
                State.COMPLETING: self._complete,
                State.HOLDING: still,
                State.UNHOLDING: self.actions.hold_state.gate.release,
                State.SUSPENDING: still,
                State.UNSUSPENDING: self.actions.hold_state.gate.release,
                State.STOPPING: self._stop,
                State.ABORTING: self._stop,
                State.CLEARING: still,
            },
            self.actions.hold_state,
            self.batches.enter,
            self.batches.accept,
            self.batches.beside,
        )
        post = self.machine.post

        def racing(verb: str, request: CommandRequest, reason: str = "") -> None:
            post(verb, request, reason)  # it waits in the inbox,
            before(verb)  # and this comes in between

        self.machine.post = racing  # type: ignore[method-assign]
        self.batches.drive(self.machine)
        self.machine.start()

    def _complete(self) -> None:
        self.actions.move()
        self.batches.count(_result(self.actions.result))

    def _stop(self) -> None:
        assert self.machine.wait_no_action(10)

    def settle(self) -> State:
        """Until nothing is to come by itself any more."""
        steady, give_up_s = 0, time.monotonic() + 60
        while steady < 3:
            assert time.monotonic() < give_up_s, f"still {self.machine.state}"
            asked = threading.Event()
            self.machine.decide(asked.set)
            assert asked.wait(60)
            quiet = self.machine.state in SETTLED and (self.machine.wait_no_action(0.01) or self._waits_at_gate)
            steady = steady + 1 if quiet else 0
        return self.machine.state

    def await_motion(self) -> None:
        """Until a motion is under way."""
        self._until(lambda: self.actions.hold_state.gate.is_moving)

    def await_state(self, state: State) -> None:
        self._until(lambda: self.machine.state is state)

    def _until(self, holds: Callable[[], bool]) -> None:
        give_up_s = time.monotonic() + 60
        while not holds():
            assert time.monotonic() < give_up_s, f"still {self.machine.state}"
            time.sleep(0.001)

    @property
    def _waits_at_gate(self) -> bool:
        """Whether the action of the held state came to the gate when it was shut: it waits there, and only there."""
        return self.machine.state in PAUSES and self.actions.hold_state.gate.held and self.actions.at_gate > 0

    def close(self) -> None:
        if self.machine.state not in (State.STOPPED, State.ABORTED):
            self.machine.command("stop", OPERATOR)
            self.settle()
        self.machine.close()


def _result(result: str) -> CycleResult:
    return CycleResult.model_validate(
        {"cycle_id": "c", "object": "", "result": result, "code": None, "reason": "", "stages": {}, "wall_s": 0.0,
         "recording": ""}
    )  # fmt: skip
