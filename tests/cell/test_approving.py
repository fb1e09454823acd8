"""A person approves each planned pick: nothing of it moves before, whatever comes in whatever order."""

from __future__ import annotations

import itertools
import threading
import time
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus import topics
from bus.arrays import Transform
from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure, Refused
from bus.messages import Approval, Proposal
from cell.machine.gate import Gate
from cell.machine.leases import Leases
from cell.machine.states import ANSWERS, State
from cell.pick.approving import Approvals, Planned, approved
from cell.pick.stages import Stages
from cell.pick.withdrawal import Withdrawal
from tests.cell.bench import OPERATOR, SETTLED, Bench


def _planned(cycle_id: str = "c", passed_over: int = 0) -> Planned:
    proposal = Proposal(
        proposal_id=f"{cycle_id}-{passed_over}", cycle_id=cycle_id, grasp=passed_over, base_from_tcp=np.eye(4),
        score=0.5, opening_m=0.08, object="a red thing", motion_s=9.0, segments_s={"reach": 2.0}, rejected=0,
        passed_over=passed_over, until_ns=0,
    )  # fmt: skip
    return cast(Planned, SimpleNamespace(proposal=proposal))


def _stages(gate: Gate, withdrawal: Withdrawal | None = None) -> Stages:
    log = cast(Any, SimpleNamespace(check=lambda: None))
    return Stages("c", lambda topic, message: None, lambda stage: None, log, gate, withdrawal or Withdrawal())


def _next(passed_over: tuple[Transform, ...]) -> Planned:
    return _planned(passed_over=len(passed_over))


# --- the answer -------------------------------------------------------------------------------------------------------


def test_an_answer_counts_once_and_names_who_gave_it_and_why() -> None:
    approvals = Approvals()
    with approvals.asked(_planned()):
        assert approvals.waiting is not None and approvals.waiting.proposal_id == "c-0"
        given = approvals.answer("approve", "c-0", "ann", "looks good", 7)
        with pytest.raises(Refused, match="No planned motion waits"):
            approvals.answer("reject", "", "bob", "", 8)
        assert approvals.wait(Cancel(), 60.0) is given
    assert (given.client_id, given.reason, given.decided_ns) == ("ann", "looks good", 7)


def test_who_approves_another_plan_than_waits_is_refused_and_so_is_who_names_none() -> None:
    approvals = Approvals()
    with approvals.asked(_planned(passed_over=1)):
        for named in ("c-0", ""):
            with pytest.raises(Refused, match="'c-1' waits") as refused:
                approvals.answer("approve", named, "ann", "", 0)
            assert refused.value.code == "OTHER_PROPOSAL"
        assert approvals.answer("reject", "", "ann", "", 0).decision == "reject", "who rejects need not have looked"


def test_without_an_answer_in_time_the_cycle_ends_and_a_late_one_is_refused() -> None:
    times_s = iter([0.0, 61.0])
    approvals = Approvals(lambda: next(times_s))
    with approvals.asked(_planned()):
        with pytest.raises(CycleFailure) as over:
            approvals.wait(Cancel(), 60.0)
        assert over.value.failure is Code.APPROVAL_TIMEOUT
        with pytest.raises(Refused):
            approvals.answer("approve", "c-0", "ann", "", 0)


def test_where_only_the_holder_approves_everybody_else_is_told_so() -> None:
    leases = Leases(lambda client_id, why: None, 60.0, 1.0, of_holder=frozenset({"approve"}))
    with pytest.raises(Refused, match="'nobody'"):
        leases.require("approve", "ann", 0.0)
    leases.change("ann", True)
    leases.take("pick", "ann")
    leases.require("approve", "ann", 0.0)
    with pytest.raises(Refused, match="holds the lease, which is 'ann'") as refused:
        leases.require("approve", "bob", 0.0)
    assert refused.value.code == "LEASE_HELD"
    leases.require("reject", "bob", 0.0)


# --- the cycle --------------------------------------------------------------------------------------------------------


def _answering(approvals: Approvals, *decisions: str) -> threading.Thread:
    """Answers one proposal after the other, as soon as it waits."""

    def answer() -> None:
        for number, decision in enumerate(decisions):
            while (asked := approvals.waiting) is None or asked.passed_over != number:
                time.sleep(0.001)
            approvals.answer(cast(Any, decision), asked.proposal_id, "ann", f"because {number}", number)

    thread = threading.Thread(target=answer)
    thread.start()
    return thread


def test_what_is_passed_over_is_left_out_until_a_plan_is_approved() -> None:
    approvals, stages = Approvals(), _stages(Gate())
    thread = _answering(approvals, "next_grasp", "next_grasp", "approve")
    assert approved(stages, approvals, _planned(), _next, 60.0).proposal.proposal_id == "c-2"
    thread.join()
    assert [answer.decision for answer in stages.approvals] == ["next_grasp", "next_grasp", "approve"]
    assert [answer.reason for answer in stages.approvals] == ["because 0", "because 1", "because 2"]


def test_a_rejected_plan_ends_the_cycle_with_who_and_why() -> None:
    approvals, stages = Approvals(), _stages(Gate())
    thread = _answering(approvals, "reject")
    with pytest.raises(CycleFailure, match="ann rejected it: because 0") as rejected:
        approved(stages, approvals, _planned(), _next, 60.0)
    thread.join()
    assert rejected.value.failure is Code.REJECTED and [one.decision for one in stages.approvals] == ["reject"]


def test_when_all_grasps_are_passed_over_the_cycle_is_rejected_and_no_look_follows() -> None:
    def none(passed_over: tuple[Transform, ...]) -> Planned:
        raise CycleFailure(Code.NO_GRASP, "All 3 grasps are like one that failed before.")

    approvals = Approvals()
    thread = _answering(approvals, "next_grasp")
    with pytest.raises(
        CycleFailure, match="there is no other grasp: each is like one that was passed over"
    ) as rejected:
        approved(_stages(Gate()), approvals, _planned(), none, 60.0)
    thread.join()
    assert rejected.value.failure is Code.REJECTED


@pytest.mark.parametrize(("end", "code"), [("stop", Code.STOPPED), ("cancel", Code.CANCELLED)])
def test_a_stop_and_a_cancelled_job_end_the_wait(end: str, code: Code) -> None:
    approvals, gate, withdrawal = Approvals(), Gate(), Withdrawal()
    threading.Timer(0.05, gate.halt if end == "stop" else withdrawal.cancel).start()
    with pytest.raises(CycleFailure) as ended:
        approved(_stages(gate, withdrawal), approvals, _planned(), _next, 60.0)
    assert ended.value.failure is code and approvals.waiting is None


def test_an_answer_that_comes_with_a_stop_does_not_count() -> None:
    approvals, gate = Approvals(), Gate()
    stages = _stages(gate)
    with approvals.asked(_planned()):
        approvals.answer("approve", "c-0", "ann", "", 0)
        gate.halt()
        with pytest.raises(CycleFailure):
            approvals.wait(stages.cancel, 60.0)


# --- the whole machine ------------------------------------------------------------------------------------------------

STEPS = st.lists(
    st.sampled_from(
        ["reset", "pick", "pick", "start", *ANSWERS, "approve", "approve other", "approve old", "hold", "unhold",
         "suspend", "unsuspend", "stop", "abort", "clear", "cancel", "lose", "late"]
    ),
    max_size=20,
)  # fmt: skip


class Asking(Bench):
    """A bench whose picks ask for approval, and then move."""

    def __init__(self) -> None:
        self.late_s, self.moved = 0.0, list[str]()
        self.numbers = itertools.count()
        super().__init__()
        self.actions.approvals = Approvals(lambda: self.late_s)
        self.actions.pick = self._pick

    def _pick(self) -> None:
        cycle_id, gate = f"c{next(self.numbers)}", self.actions.hold_state.gate

        def planned(passed_over: tuple[Transform, ...]) -> Planned:
            return _planned(cycle_id, len(passed_over))

        try:
            chosen = approved(_stages(gate), self.actions.approvals, planned(()), planned, 60.0)
        except CycleFailure as failure:
            if failure.failure is Code.STOPPED:
                raise
            return
        with gate.motion() as may_begin:
            if may_begin:
                self.moved.append(chosen.proposal.proposal_id)

    def calm(self) -> None:
        """Until the cell waits for a person, or for a command."""
        give_up_s = time.monotonic() + 60
        while self.actions.approvals.waiting is None and self.machine.state not in SETTLED:
            assert time.monotonic() < give_up_s
            time.sleep(0.0005)


@settings(max_examples=60)
@given(steps=STEPS)
def test_no_motion_of_a_pick_ever_begins_that_was_not_approved_by_its_own_name(steps: list[str]) -> None:
    bench, allowed, last = Asking(), set[str](), ""
    try:
        for step in ["reset", "pick", *steps]:
            bench.calm()
            asked = bench.actions.approvals.waiting
            now, held = asked.proposal_id if asked is not None else "", bench.machine.state is not State.EXECUTE
            last = now or last
            if step == "lose":
                bench.batches.lose_lease("op", "its token is gone")
                continue
            if step == "late":
                bench.late_s += 100.0
                continue
            verb, _, which = step.partition(" ")
            proposal = {"": now, "other": "another", "old": f"{last}x"}[which]
            reply = bench.machine.command(verb, OPERATOR.model_copy(update={"proposal": proposal, "cycles": 1}))
            if verb == "approve" and reply.ok:
                assert not held and not which and now
                allowed.add(proposal)
            assert set(bench.moved) <= allowed
        bench.calm()
        assert set(bench.moved) <= allowed
    finally:
        bench.close()


def _until(bench: Bench, state: str) -> None:
    while bench.machine.state != state:
        time.sleep(0.001)


def test_while_it_is_held_nobody_approves_and_who_ends_the_hold_moves_nothing() -> None:
    bench = Asking()
    for verb in ("reset", "pick"):
        bench.machine.command(verb, OPERATOR)
        bench.calm()
    bench.machine.command("hold", OPERATOR)
    _until(bench, "Held")
    asked = bench.actions.approvals.waiting
    assert asked is not None
    yes = OPERATOR.model_copy(update={"proposal": asked.proposal_id})
    refused = bench.machine.command("approve", yes)
    assert (refused.ok, refused.code) == (False, "WRONG_STATE") and "unhold" in refused.advice
    bench.machine.command("unhold", OPERATOR)
    _until(bench, "Execute")
    assert bench.moved == []
    assert bench.machine.command("approve", yes).ok
    assert bench.settle() is State.COMPLETE and bench.moved == [asked.proposal_id]
    bench.close()


def test_the_answers_travel_as_they_were_given() -> None:
    answer = Approval(proposal_id="c-0", decision="reject", client_id="ann", decided_ns=1, base_from_tcp=np.eye(4))
    record = topics.APPROVE.says(
        cycle_id="c", stage="approve", started_ns=0, duration_s=1.0, result=answer, failure=None
    )
    assert topics.APPROVE.says.model_validate_json(record.model_dump_json()).result.client_id == "ann"
