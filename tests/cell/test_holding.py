"""Whatever comes in whatever order - lost leases, holds, ends of picks - the gate is shut only while a cell is held."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.commands import CommandRequest
from bus.messages import CycleResult
from cell.daemon.actions import Actions
from cell.daemon.batch_control import BatchControl
from cell.daemon.publisher import Publisher
from cell.machine.hold_state import HoldState
from cell.machine.owner import Machine
from cell.machine.states import PAUSES, State
from config.schema import RetrySettings

OPERATOR = CommandRequest(client_id="op")
SETTLED = {State.STOPPED, State.IDLE, State.COMPLETE, State.ABORTED, State.HELD, State.SUSPENDED}


@dataclass
class _Actions:
    """What `BatchControl` and the machine use of the actions: motions through a real gate, without devices."""

    hold_state: HoldState = field(default_factory=HoldState)
    result: str = "SUCCESS"

    @property
    def table(self) -> Any:
        return self

    def require_possible(self, _request: CommandRequest) -> None: ...

    def restart_attempts(self, *_: Any, **__: Any) -> None: ...

    def take_hold_after_failures(self) -> str:
        return ""

    def move(self) -> None:
        with self.hold_state.gate.motion():
            pass


class _Publisher:
    def __init__(self) -> None:
        self.states: list[tuple[State, str]] = []

    def publish_state(self, state: State, reason: str) -> None:
        self.states.append((state, reason))

    def publish_event(self, *_: str) -> None: ...


class Bench:
    """A real machine and its control; ``before``: called with every command that the cell gives itself, just before."""

    def __init__(self, before: Callable[[str], None] = lambda verb: None) -> None:
        self.actions, self.publisher = _Actions(), _Publisher()
        self.batches = BatchControl(cast(Actions, self.actions), cast(Publisher, self.publisher), RetrySettings())
        still = lambda: None  # noqa: E731
        moves = self.actions.move
        self.machine = Machine(
            {
                State.RESETTING: moves,
                State.STARTING: still,
                State.EXECUTE: moves,
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
        steady = 0
        while steady < 3:
            asked = threading.Event()
            self.machine.decide(asked.set)
            assert asked.wait(60)
            quiet = self.machine.wait_no_action(0.01) and self.machine.state in SETTLED
            steady = steady + 1 if quiet else 0
        return self.machine.state

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


@pytest.mark.parametrize("verb", ["reset", "start"])
def test_a_lease_lost_between_two_picks_ends_the_start_and_leaves_nothing_shut(verb: str) -> None:
    """Lost after the cell posted its own next command: the reason is not cleared by it, and nobody waits at a gate."""
    lost: list[str] = []

    def lose(posted: str) -> None:
        if posted == verb and not lost:
            lost.append(posted)
            bench.batches.lose_lease("op", "its token is gone")

    bench = Bench(lose)
    bench.machine.command("reset", OPERATOR)
    assert bench.settle() is State.IDLE
    assert bench.machine.command("start", OPERATOR.model_copy(update={"cycles": 3})).ok
    state = bench.settle()
    assert lost and (bench.actions.hold_state.gate.held, state in PAUSES) in ((False, False), (True, True))
    assert any("lease of 'op' was lost" in reason for _, reason in bench.publisher.states)
    assert bench.machine.command("unhold" if state in PAUSES else "reset", OPERATOR).ok
    assert bench.settle() in (State.IDLE, State.COMPLETE)
    bench.close()


VERBS = ["reset", "start", "pick", "stop", "abort", "clear", "hold", "unhold", "suspend", "unsuspend"]
STEPS = st.lists(st.sampled_from([*VERBS, *VERBS, "lose", "fail", "settle"]), max_size=25)


@settings(max_examples=150)
@given(steps=STEPS, when=st.lists(st.sampled_from(["", "lose", "hold", "stop"]), max_size=8))
def test_the_gate_is_shut_exactly_while_the_cell_is_held(steps: list[str], when: list[str]) -> None:
    """``when``: what happens while one of the cell's own commands waits in the inbox."""
    races = iter(when)

    def race(_verb: str) -> None:
        what = next(races, "")
        if what == "lose":
            bench.batches.lose_lease("op", "its token is gone")
        elif what:
            bench.machine.decide(lambda: None)
            threading.Thread(target=bench.machine.command, args=(what, OPERATOR)).start()

    bench = Bench(race)
    for step in steps:
        if step == "lose":
            bench.batches.lose_lease("op", "its token is gone")
        elif step == "fail":
            bench.actions.result = "FAILED"
        elif step == "settle":
            bench.settle()
        else:
            cycles = {"cycles": 3} if step == "start" else {}
            bench.machine.command(step, OPERATOR.model_copy(update=cycles))
    state = bench.settle()
    hold_state = bench.actions.hold_state
    assert hold_state.gate.held == (state in PAUSES) or hold_state.gate.halted
    assert (hold_state.reason != "") == (state in PAUSES), "who asks why it is held is told"
    bench.close()
