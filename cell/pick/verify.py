"""Stage 5, verify: is the object in the hand? By measured width and load, and a second capture if needed. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.codes import Code
from bus.messages import Detections, Execution, Grasp, HandState, Motion, Observation, SegmentRun, Verdict
from bus.messages.plan import ONLY_TO_LOOK
from config.schema import Station
from perception.fusion.agreed import corrected
from perception.scene.change import cleared_fraction
from planning.robot import Robot

_HEAD, _TAIL = 10, 20
"""Number of measured samples (10 ms each) for the load of the empty hand at the start, and of the held object."""


def verify(
    execution: Execution,
    detections: Detections,
    before: Observation,
    after: Observation | None,
    robot: Robot,
    station: Station,
) -> Verdict:
    """The verdict on a finished execution (``execution.stopped_in`` is None).

    Every criterion must hold during the whole hold: width, load, and the object gone from its place, where the second
    capture sees that; the width also on every way with the object.

    Args:
        after: the second capture; None when there was none, because `is_clear`.

    Raises: ValueError for an execution that did not reach its hold.
    """
    grasped = execution.grasped
    if grasped is None:
        raise ValueError("verify needs an execution that reached its hold")
    felt = _felt(execution.runs, robot)
    cleared = None
    if after is not None:
        mount = detections.scene.mount
        cleared = cleared_fraction(detections, corrected(before, mount), corrected(after, mount), station)
    failed = _failed(grasped, felt, station) or _not_cleared(cleared, station)
    place = f"{(cleared or 0.0) * 100:.0f} % of its place is empty"
    if cleared is None:
        place = "its place was not " + ("looked at" if after is None else "seen")
    held = (None, f"Held {min(felt.widths_m) * 1e3:.1f} mm wide, {felt.load_n:.2f} N heavy; {place}.")
    code, reason = failed or held
    return Verdict(
        held=code is None,
        code=code,
        reason=reason,
        hold_s=float(sum(run.motion.t_s[-1] for run in execution.runs if run.name == "hold")),
        width_min_m=min(felt.widths_m),
        load_n=felt.load_n,
        cleared_fraction=cleared,
        carried_n=felt.carried_n if execution.began is not None else None,
    )


def is_clear(grasp: Grasp, grasped: HandState, runs: Sequence[SegmentRun], robot: Robot, station: Station) -> bool:
    """Whether width and load tell by themselves how the pick went, so that a look at the place would change nothing.

    They do when one of them fails; and when the load is far from the measurement's errors, in the hold and on the way
    there, and the fingers stand where they should on that object.

    Args:
        runs: to the end of the hold.
    """
    need, felt = station.verify, _felt(runs, robot)
    if _failed(grasped, felt, station) is not None:
        return True
    is_as_planned = abs(grasped.width_m - grasp.width_m) <= need.clear_width_m
    return is_as_planned and min(felt.load_n, felt.carried_n) >= need.clear_load_n


class _Felt(NamedTuple):
    """What hand and arm measured with the object: every width, the load in the hold, and on the way there."""

    widths_m: list[float]
    load_n: float
    carried_n: float


def _felt(runs: Sequence[SegmentRun], robot: Robot) -> _Felt:
    def of(name: str) -> list[Motion]:
        return [run.motion for run in runs if run.name == name]

    on_the_way = [state.width_m for run in runs for state in run.hand_meanwhile]
    widths_m = [*on_the_way, *(run.hand.width_m for run in runs if run.name == "hold" or run.name in ONLY_TO_LOOK)]
    empty_n = _weight_n(of("reach"), slice(None, _HEAD), robot)
    load_n = _weight_n(of("hold"), slice(-_TAIL, None), robot) - empty_n
    return _Felt(widths_m, load_n, _weight_n(of("carry"), slice(None), robot) - empty_n)


def _failed(grasped: HandState, felt: _Felt, station: Station) -> tuple[Code, str] | None:
    """Code and text of the first criterion of width and load that fails; None when all hold."""
    need, width_min_m = station.verify, min(felt.widths_m)
    if grasped.width_m < need.min_width_m:
        return Code.GRASP_MISSED, f"The fingers closed to {grasped.width_m * 1e3:.1f} mm: nothing between them."
    if width_min_m < need.min_width_m or grasped.width_m - width_min_m > need.max_width_loss_m:
        return Code.DROPPED, (
            f"The width fell from {grasped.width_m * 1e3:.1f} to {width_min_m * 1e3:.1f} mm after the grasp."
        )
    opened = opened_by_another(grasped, max(felt.widths_m), station)
    if opened:
        return Code.DROPPED, opened
    if felt.load_n < need.min_load_n:
        return Code.DROPPED, f"The arm carries {felt.load_n:.2f} N; at least {need.min_load_n:.2f} N were expected."
    return None


def _not_cleared(cleared: float | None, station: Station) -> tuple[Code, str] | None:
    if cleared is None or cleared >= station.verify.min_cleared_fraction:
        return None
    return Code.NOT_CLEARED, f"Only {cleared * 100:.0f} % of where the object lay is empty now."


def _weight_n(motions: list[Motion], samples: slice, robot: Robot) -> float:
    """Mean downward force at the tcp over some samples of each motion [N]."""
    forces = [
        -robot.tcp_force_n(q_rad, tau_ext_nm)[2]
        for motion in motions
        for q_rad, tau_ext_nm in zip(motion.q_rad[samples], motion.tau_ext_nm[samples], strict=True)
    ]
    return float(np.mean(forces))


def opened_by_another(grasped: HandState, width_m: float, station: Station) -> str:
    """Why a hand at ``width_m`` does not hold what it ``grasped``, or "": closing fingers never open for an object."""
    if width_m <= grasped.width_m + station.verify.max_width_loss_m:
        return ""
    return (
        f"The hand opened from {grasped.width_m * 1e3:.1f} to {width_m * 1e3:.1f} mm while it held the object:"
        " somebody else moved it."
    )


def lost_on_the_way(grasped: HandState, before_release: HandState, station: Station) -> str:
    """Why the object was not in the hand before the release, or ""."""
    if before_release.width_m < station.verify.min_width_m:
        return f"The fingers were closed ({before_release.width_m * 1e3:.1f} mm) before the object was laid down."
    return opened_by_another(grasped, before_release.width_m, station)
