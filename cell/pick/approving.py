"""A person approves each planned pick before the arm moves for it (``execute.approve``).

The cycle waits in its stage ``approve`` for one answer: approve, plan the next grasp, or reject. It moves nothing
meanwhile. A stop, a cancelled or late job, and the time itself end the wait; a hold closes the gate as ever, and who
approves must end it first. The looks before have moved the arm already, and the way back from them does.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

from bus import topics
from bus.arrays import Transform, Vector3
from bus.cancel import Cancel
from bus.codes import Code
from bus.commands import Event
from bus.errors import CycleFailure, Refused
from bus.messages import ONLY_TO_LOOK, Approval, Decision, Detections, Grasp, Observation, PickPlan, Proposal
from bus.trajectory import TICK_S
from cell.pick.outcome import found_thing
from cell.pick.stages import Stages

_LOOK_S = 0.05
_NO_OTHER = frozenset({Code.NO_GRASP, Code.UNREACHABLE, Code.COLLISION})
"""How planning ends when no grasp is left that was not passed over."""


@dataclass(frozen=True)
class Planned:
    """A plan, and what it was made of.

    Attributes:
        passed_over: number of grasps that were passed over before. ``until_ns``: when the wait is over, UTC; 0 = none.
        place, place_m: as of the `Proposal`.
    """

    cycle_id: str
    found: Detections
    plan: PickPlan
    looks: Sequence[Observation]
    passed_over: int = 0
    until_ns: int = 0
    place: str = ""
    place_m: Vector3 | None = None

    @property
    def grasp(self) -> Grasp:
        """The grasp that was chosen."""
        return self.found.grasps[self.plan.grasp]

    @cached_property
    def proposal(self) -> Proposal:
        """The question that a person is asked."""
        thing = found_thing(self.found, self.grasp)
        lasts_s: dict[str, float] = {part.name: len(part.trajectory.filtered()) * TICK_S for part in self.plan.segments}
        return Proposal(
            proposal_id=f"{self.cycle_id}-{self.passed_over}",
            cycle_id=self.cycle_id,
            grasp=self.plan.grasp,
            base_from_tcp=self.grasp.base_from_tcp,
            score=self.grasp.score,
            opening_m=self.grasp.opening_m,
            object=thing.text if thing is not None else "",
            thing=self.grasp.instance if thing is not None else 0,
            place=self.place,
            place_m=self.place_m,
            motion_s=sum(lasts for name, lasts in lasts_s.items() if name not in ONLY_TO_LOOK),
            segments_s=lasts_s,
            rejected=len(self.plan.rejected),
            passed_over=self.passed_over,
            until_ns=self.until_ns,
        )


class Approvals:
    """The question that is open in a cell, and its answer. Any thread may call any member.

    Args:
        now_s: a clock that only goes forward.

    Attributes:
        last: the last plan, asked about or not; None before the first.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._change = now_s, threading.Condition()
        self._open: Planned | None = None
        self._answer: Approval | None = None
        self.last: Planned | None = None

    @property
    def waiting(self) -> Proposal | None:
        """The proposal that waits for an answer."""
        with self._change:
            return self._open.proposal if self._open is not None and self._answer is None else None

    @contextmanager
    def asked(self, planned: Planned) -> Iterator[None]:
        """Context in which the plan can be answered."""
        with self._change:
            self.last = self._open = planned
            self._answer = None
        try:
            yield
        finally:
            with self._change:
                self._open = None

    def answer(self, decision: Decision, proposal_id: str, client_id: str, reason: str, decided_ns: int) -> Approval:
        """Answer the open question, once. Raises: Refused (NO_PROPOSAL, OTHER_PROPOSAL)."""
        with self._change:
            planned = self._open
            if planned is None or self._answer is not None:
                raise Refused(
                    "No planned motion waits for an answer.",
                    "A cycle asks in its stage `approve`, where execute.approve is not 'no'.",
                    code="NO_PROPOSAL",
                )
            asked = planned.proposal
            if proposal_id != asked.proposal_id and (proposal_id or decision == "approve"):
                raise Refused(
                    f"The proposal {asked.proposal_id!r} waits, not {proposal_id!r}.",
                    "Look at it, and name it: `cell approve`, cycle/proposal, GET /api/proposal.",
                    code="OTHER_PROPOSAL",
                )
            self._answer = Approval(
                proposal_id=asked.proposal_id,
                decision=decision,
                client_id=client_id,
                decided_ns=decided_ns,
                base_from_tcp=asked.base_from_tcp,
                reason=reason,
            )
            self._change.notify_all()
            return self._answer

    def wait(self, cancel: Cancel, most_s: float) -> Approval:
        """Wait for the answer to the open question.

        Args:
            cancel: ends the wait. ``most_s``: the longest wait.

        Raises: CycleFailure (STOPPED by ``cancel``, APPROVAL_TIMEOUT).
        """
        late_s = self._now_s() + most_s
        with self._change:
            while True:
                cancel.raise_if_set("approve")
                if self._answer is not None:
                    return self._answer
                if self._now_s() > late_s:
                    self._open = None  # nobody is told that a late answer counts
                    raise CycleFailure(Code.APPROVAL_TIMEOUT, f"Nobody answered for {most_s:g} s.")
                self._change.wait(_LOOK_S)


def approved(
    stages: Stages,
    approvals: Approvals,
    planned: Planned,
    plan_next: Callable[[tuple[Transform, ...]], Planned],
    approve_s: float,
) -> Planned:
    """Ask until a plan is approved.

    Args:
        plan_next: plans without grasps like these (4, 4), which were passed over.
        approve_s: the longest wait for one answer.

    Returns: the approved plan; the answers are kept in ``stages``.
    Raises: CycleFailure (REJECTED, APPROVAL_TIMEOUT; STOPPED, CANCELLED, DEADLINE).
    """
    passed_over: tuple[Transform, ...] = ()
    while True:
        with approvals.asked(planned):
            stages.publish(topics.PROPOSAL, planned.proposal)
            stages.tell(_question(planned.proposal))
            answer = stages.run("approve", topics.APPROVE, lambda: approvals.wait(stages.cancel, approve_s))
        stages.approvals.append(answer)
        stages.tell(_told(answer))
        if answer.decision == "approve":
            return planned
        if answer.decision == "reject":
            raise stages.fail(CycleFailure(Code.REJECTED, f"{answer.client_id} rejected it{_because(answer)}."))
        passed_over = (*passed_over, answer.base_from_tcp)
        try:
            planned = plan_next(passed_over)
        except CycleFailure as failure:
            if failure.failure not in _NO_OTHER:
                raise
            alike = "each is like one that was passed over, or failed before."
            why = alike if failure.failure is Code.NO_GRASP else failure.text
            text = f"Passed over: {len(passed_over)}, and there is no other grasp: {why}"
            raise stages.fail(CycleFailure(Code.REJECTED, text, failure.rejected)) from failure


def _question(asked: Proposal) -> Event:
    text = f"{asked.proposal_id} waits for approval: {asked.in_words}."
    return Event(code="APPROVE", severity="info", text=text, advice="`cell approve`, `cell next-grasp`, `cell reject`.")


def _told(answer: Approval) -> Event:
    code, did = {
        "approve": ("APPROVED", "approved"),
        "next_grasp": ("PASSED_OVER", "passed over"),
        "reject": ("REJECTED", "rejected"),
    }[answer.decision]
    return Event(code=code, severity="info", text=f"{answer.client_id} {did} {answer.proposal_id}{_because(answer)}.")


def _because(answer: Approval) -> str:
    return f": {answer.reason.rstrip('.')}" if answer.reason else ""
