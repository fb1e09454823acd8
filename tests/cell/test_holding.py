"""Whatever comes in whatever order - lost leases, holds, ends of picks - the gate is shut only while a cell is held."""

from __future__ import annotations

import threading
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.messages import Job
from cell.machine.states import PAUSES, State
from tests.cell.bench import OPERATOR, Bench


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


VERBS = [
    "reset",
    "start",
    "pick",
    "stop",
    "abort",
    "clear",
    "hold",
    "unhold",
    "suspend",
    "unsuspend",
    "cancel",
    "queue",
]
STEPS = st.lists(st.sampled_from([*VERBS, *VERBS, "cancel", "lose", "fail", "settle"]), max_size=25)


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
            by_step: dict[str, dict[str, Any]] = {"start": {"cycles": 3}, "queue": {"job": Job(queue=True)}}
            verb = "pick" if step == "queue" else step
            bench.machine.command(verb, OPERATOR.model_copy(update=by_step.get(step, {})))
    state = bench.settle()
    hold_state = bench.actions.hold_state
    assert hold_state.gate.held == (state in PAUSES) or hold_state.gate.halted
    assert (hold_state.reason != "") == (state in PAUSES), "who asks why it is held is told"
    bench.close()
