"""What follows when the arm meets something on its approach: the fingers close there, or it goes back as it came."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bus.errors import CycleFailure
from bus.messages import Contact, Motion, PickPlan
from bus.trajectory import Trajectory
from planning.feeling import closes_within_m, guard, joined
from planning.pregrasp import approach_begins
from planning.robot import Robot
from planning.world import Collision

Judge = Callable[[Trajectory], Collision | None]
"""What the empty hand would touch on a motion, at the width of the thing between its fingers."""


@dataclass(frozen=True)
class Thing:
    """What is to be grasped, as far as it matters when the arm meets something before.

    Attributes:
        top_m: its highest point in ``base``; None = unknown.
        judge: judges the way up with it from elsewhere than was planned; None = there is no other way up.
    """

    top_m: float | None = None
    judge: Judge | None = None


def guarded(robot: Robot, reach: Trajectory) -> Trajectory:
    """Return ``reach`` as it is played: the arm waits before its approach line, and feels on it if the station says."""
    station = robot.station
    begins_at = approach_begins(robot, reach, station.planning.approach_m)
    limit_n = station.execute.contact_n
    felt = guard(robot, reach, begins_at, limit_n) if limit_n else None
    return reach.model_copy(update={"waits_at": begins_at, "guard": felt})


def contact_of(robot: Robot, motion: Motion, reach: Trajectory, thing: Thing) -> Contact | None:
    """Return what the arm met on ``reach``, or None."""
    if motion.contact_n is None:
        return None
    base_from_tcp = robot.base_from_tcp(motion.q_rad[-1])
    end_m = robot.base_from_tcp(reach.end_q_rad)[:3, 3]
    return Contact(
        base_from_tcp=base_from_tcp,
        force_n=motion.contact_n,
        remaining_m=float(np.linalg.norm(end_m - base_from_tcp[:3, 3])),
        closes_within_m=closes_within_m(robot, reach.end_q_rad, thing.top_m),
    )


def from_there(robot: Robot, plan: PickPlan, motion: Motion, contact: Contact, thing: Thing) -> PickPlan | None:
    """Return the plan with its carry from where the arm rests; None when the fingers are not to close there."""
    if contact.remaining_m > contact.closes_within_m or thing.judge is None:
        return None
    parts = {part.name: part for part in plan.segments}
    try:
        carry = joined(robot, parts["carry"].trajectory, motion.commanded_q_rad[-1])
    except CycleFailure:  # no limit lets it pass: then it goes back
        return None
    if thing.judge(carry) is not None:
        return None
    parts["carry"] = parts["carry"].model_copy(update={"trajectory": carry})
    return plan.model_copy(update={"segments": tuple(parts.values())})
