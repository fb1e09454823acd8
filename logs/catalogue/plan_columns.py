"""Columns of the chosen grasp and of the plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from bus.messages import Failure, Grasp, PickPlan
from bus.messages.plan import ONLY_TO_LOOK
from bus.rejection import Rejection
from config.robot import recorded_limits
from logs.catalogue.column import Column, Told, Value, attribute, packed

Array = npt.NDArray[np.float64]


def _chosen(take: Callable[[Grasp], Value]) -> Callable[[Told], Value]:
    return lambda told: take(told.chosen) if told.chosen is not None else None


# --- the chosen grasp -------------------------------------------------------------------------------------------------


def _coordinate(axis: int) -> Callable[[Told], Value]:
    return _chosen(lambda grasp: float(grasp.base_from_tcp[axis, 3]))


def _lean_rad(grasp: Grasp) -> Value:
    return float(np.arccos(np.clip(-grasp.base_from_tcp[2, 2], -1.0, 1.0)))


def _terms(grasp: Grasp) -> Value:
    return packed(grasp.terms)


# --- the plan ---------------------------------------------------------------------------------------------------------


def _ways(told: Told) -> tuple[Rejection, ...]:
    """The ways to grasp that plan rejected, also where it failed."""
    plan = told.record.stages.get("plan")
    if plan is None:
        return ()
    ended: PickPlan | Failure | None = plan.result or plan.failure
    return ended.rejected if ended is not None else ()


def _rejected_codes(told: Told) -> Value:
    return packed(Counter(way.code.value for way in _ways(told)))


def _in_the_way(told: Told) -> Value:
    return packed(Counter(way.obstacle.name for way in _ways(told) if way.obstacle is not None))


def _planned_s(told: Told) -> Value:
    if told.plan is None:
        return None
    return float(sum(one.trajectory.duration_s for one in told.plan.segments if one.name not in ONLY_TO_LOOK))


def _searched(told: Told) -> Value:
    return sum(one.route == "searched" for one in told.plan.segments) if told.plan is not None else None


def _margins_rad(told: Told) -> Array | None:
    """The smallest distance (joints,) of each joint from its limits in all planned motion; None without any."""
    if told.plan is None:
        return None
    planned = [one.trajectory.raw_q_rad for one in told.plan.segments if one.name not in ONLY_TO_LOOK]
    if not any(len(q_rad) for q_rad in planned):
        return None
    q_rad, limits = np.concatenate(planned), recorded_limits(told.record.station)
    return np.asarray(np.minimum(q_rad.min(axis=0) - limits.lower_rad, limits.upper_rad - q_rad.max(axis=0)))


def _joint_margin_rad(told: Told) -> Value:
    margins_rad = _margins_rad(told)
    return float(margins_rad.min()) if margins_rad is not None else None


def _joint_nearest(told: Told) -> Value:
    margins_rad = _margins_rad(told)
    return int(margins_rad.argmin()) + 1 if margins_rad is not None else None


CHOSEN = (
    Column("grasp", "INTEGER", "", "Rank of the chosen grasp, from 0.", attribute("plan", "grasp")),
    Column("score", "REAL", "", "Its score.", attribute("chosen", "score")),
    Column("terms", "TEXT", "", "What the score is made of: a JSON object, name to value in 0..1.",
           _chosen(_terms)),
    Column("width_m", "REAL", "m", "Width of the object between the pads, as seen.", attribute("chosen", "width_m")),
    Column("opening_m", "REAL", "m", "Hand width to approach with.", attribute("chosen", "opening_m")),
    Column("grasp_x_m", "REAL", "m", "Where it closes, in `base`.", _coordinate(0)),
    Column("grasp_y_m", "REAL", "m", "Where it closes, in `base`.", _coordinate(1)),
    Column("grasp_z_m", "REAL", "m", "Where it closes, in `base`.", _coordinate(2)),
    Column("lean_rad", "REAL", "rad", "Angle between its approach and straight down, before the tilt.",
           _chosen(_lean_rad)),
    Column("tilt_rad", "REAL", "rad", "Tilt of the approach about the closing axis, by the plan.",
           attribute("plan", "tilt_rad")),
)  # fmt: skip

PLAN = (
    Column("rejected", "INTEGER", "", "Ways to grasp that were not feasible.",
           lambda told: len(_ways(told)) if "plan" in told.record.stages else None),
    Column("rejected_codes", "TEXT", "", "The same by reason: a JSON object, code to count.", _rejected_codes),
    Column("in_the_way", "TEXT", "", "What they would have touched, when no way was free: JSON, name to count.",
           _in_the_way),
    Column("planned_s", "REAL", "s", "Duration of all planned motion.", _planned_s),
    Column("searched", "INTEGER", "", "Segments that were searched around obstacles; the others are straight.",
           _searched),
    Column("joint_margin_rad", "REAL", "rad", "Smallest distance of a joint from its limit in all planned motion.",
           _joint_margin_rad),
    Column("joint_nearest", "INTEGER", "", "The joint that it is, from 1.", _joint_nearest),
)  # fmt: skip
