"""Stage 5, verify: is the object in the hand? By measured width, measured load, and a second capture. Pure."""

from __future__ import annotations

import numpy as np

from bus.codes import Code
from bus.messages import Detections, Execution, Grasp, HandState, Motion, Observation, Verdict
from config.schema import Station
from perception.fusion.agreed import corrected
from perception.scene.change import cleared_fraction
from planning.robot import Robot

_HEAD, _TAIL = 10, 20
"""Number of measured samples (10 ms each) for the load of the empty hand at the start, and of the held object."""
_STEADY_M = 0.001
"""What turns flush in the jaw loses width once, then keeps it to so much in the hold; what slips loses ever more."""


def verify(
    execution: Execution,
    detections: Detections,
    grasp: Grasp,
    before: Observation,
    after: Observation,
    robot: Robot,
    station: Station,
) -> Verdict:
    """The verdict on a finished execution of a grasp (``execution.stopped_in`` is None).

    Every criterion must hold during the whole hold: width, load, and the object gone from its place, where the second
    capture sees that; the width also on the way there. What turned flush in the jaw may lose width, if it keeps it;
    what is too light for the arm to weigh is held when its place is seen empty.

    Raises: ValueError for an execution that did not reach its hold.
    """
    grasped = execution.grasped
    if grasped is None:
        raise ValueError("verify needs an execution that reached its hold")
    holds = [run for run in execution.runs if run.name == "hold"]
    carries = [run for run in execution.runs if run.name == "carry"]
    on_the_way = [state.width_m for run in carries for state in run.hand_meanwhile]
    held_m = [run.hand.width_m for run in holds]
    empty_n = _weight_n([run.motion for run in execution.runs if run.name == "reach"], slice(None, _HEAD), robot)
    load_n = _weight_n([run.motion for run in holds], slice(-_TAIL, None), robot) - empty_n
    carried_n = None
    if execution.began is not None:
        carried_n = _weight_n([run.motion for run in carries], slice(None), robot) - empty_n
    mount = detections.scene.mount
    cleared = cleared_fraction(detections, grasp.instance, corrected(before, mount), corrected(after, mount), station)
    code, reason = _judge(grasped, on_the_way, held_m, load_n, cleared, station)
    return Verdict(
        held=code is None,
        code=code,
        reason=reason,
        hold_s=float(sum(run.motion.t_s[-1] for run in holds)),
        width_min_m=min(on_the_way + held_m),
        load_n=load_n,
        cleared_fraction=cleared,
        carried_n=carried_n,
    )


def _judge(
    grasped: HandState,
    on_the_way_m: list[float],
    held_m: list[float],
    load_n: float,
    cleared: float | None,
    station: Station,
) -> tuple[Code | None, str]:
    """Code and text of the first criterion that fails; None as the code when all hold."""
    need, widths_m = station.verify, on_the_way_m + held_m
    width_min_m, is_heavy = min(widths_m), load_n >= need.min_load_n
    has_turned = is_heavy and max(held_m) - min(held_m) < _STEADY_M
    if grasped.width_m < need.min_width_m:
        return Code.GRASP_MISSED, f"The fingers closed to {grasped.width_m * 1e3:.1f} mm: nothing between them."
    has_lost = grasped.width_m - width_min_m > need.max_width_loss_m
    if width_min_m < need.min_width_m or (has_lost and not has_turned):
        return Code.DROPPED, (
            f"The width fell from {grasped.width_m * 1e3:.1f} to {width_min_m * 1e3:.1f} mm after the grasp."
        )
    opened = opened_by_another(grasped, max(widths_m), station)
    if opened:
        return Code.DROPPED, opened
    if not is_heavy and (cleared is None or cleared < need.min_cleared_fraction):
        return Code.DROPPED, f"The arm carries {load_n:.2f} N; at least {need.min_load_n:.2f} N were expected."
    if cleared is not None and cleared < need.min_cleared_fraction:
        return Code.NOT_CLEARED, f"Only {cleared * 100:.0f} % of where the object lay is empty now."
    place = "its place was not seen" if cleared is None else f"{cleared * 100:.0f} % of its place is empty"
    return None, f"Held {width_min_m * 1e3:.1f} mm wide, {load_n:.2f} N heavy; {place}."


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
