"""The question to a person before the arm moves for a grasp, and the answer."""

from __future__ import annotations

from typing import Literal

from bus.arrays import Transform, Vector3
from bus.frozen import Message

Decision = Literal["approve", "next_grasp", "reject"]


class Proposal(Message):
    """A planned pick that waits for a person: nothing of it moves before somebody approves it (``execute.approve``).

    Attributes:
        cycle_id: of the cycle that waits.
        proposal_id: of this plan of this cycle; who approves names it, so that nobody approves another than they saw.
        grasp: its index among the detected grasps. ``base_from_tcp``: (4, 4), as detected. ``score``: of the detection.
        opening_m: opening of the hand on the way to it.
        object: the thing that it is to hold, in words. ``thing``: its number in the picture; 0 = it has none, or in
            recordings of before it was kept.
        place: name of the station's place where it will be laid, "" for its tray or a position. ``place_m``: (3,) of
            the tcp in ``base`` when it lets go there; None = in recordings of before it was kept.
        motion_s: how long all motions last that are played in any case. ``segments_s``: each motion.
        rejected: number of better ways to grasp that planning left out or found not feasible.
        passed_over: number of grasps that were passed over before in this cycle.
        until_ns: when the time for an answer is over, UTC.
    """

    proposal_id: str
    cycle_id: str
    grasp: int
    base_from_tcp: Transform
    score: float
    opening_m: float
    object: str
    thing: int = 0
    place: str = ""
    place_m: Vector3 | None = None
    motion_s: float
    segments_s: dict[str, float]
    rejected: int
    passed_over: int
    until_ns: int

    @property
    def in_words(self) -> str:
        """Describe what waits, for a person: the thing or else where it is, score, time of its motion, its place."""
        x_m, y_m = self.base_from_tcp[:2, 3]
        what = self.object or f"grasp {self.grasp} at ({x_m:.2f}, {y_m:.2f})"
        return f"{what}, score {self.score:.2f}, {self.motion_s:.1f} s of motion{self._to_lay}"

    @property
    def _to_lay(self) -> str:
        if self.place_m is None:
            return ""
        x_m, y_m = self.place_m[:2]
        return f", laid at {f'{self.place} ' if self.place else ''}({x_m:.2f}, {y_m:.2f})"

    def waits_in_words(self, now_ns: int) -> str:
        """Describe what waits by its id, and how long an answer counts. ``now_ns``: UTC."""
        left_s = max(0.0, (self.until_ns - now_ns) * 1e-9)
        return f"{self.proposal_id}: {self.in_words}; an answer counts for {left_s:.0f} s"


class Approval(Message):
    """The answer to one `Proposal`.

    Attributes:
        proposal_id: of the `Proposal` that is answered.
        decision: approve it; plan the next grasp instead; or end the cycle.
        client_id: the client that decided. ``decided_ns``: when, UTC. ``reason``: why, in its words.
        base_from_tcp: (4, 4) of the proposed grasp; after ``next_grasp`` planning leaves out those like it.
    """

    proposal_id: str
    decision: Decision
    client_id: str
    decided_ns: int
    base_from_tcp: Transform
    reason: str = ""
