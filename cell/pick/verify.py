"""Stage 5, verify: is the object in the hand? By measured width and load, and a second capture if needed. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from bus.codes import Code
from bus.messages import Contact, Detections, Execution, Grasp, HandState, Motion, Observation, SegmentRun, Verdict
from bus.messages.plan import ONLY_TO_LOOK
from cell.pick.several import OneThing, may_be_several, several
from config.schema import Station
from perception.fusion.agreed import corrected
from perception.scene.change import cleared_fraction
from perception.scene.surroundings import surroundings
from planning.height_field import Sight
from planning.held_part import held_parts
from planning.robot import Robot

_HEAD, _TAIL = 10, 20
"""Number of measured samples (10 ms each) for the load of the empty hand at the start, and of the held object."""
_SAME_LOAD = 0.2
"""By so much of it the load on the way, with all its accelerations, differs from that in the hold."""
_STEADY_M = 0.001
"""A thing that turns flush in the jaw loses width once, then keeps it to so much; one that slips loses ever more."""


def verify(
    execution: Execution,
    detections: Detections,
    grasp: Grasp,
    before: Observation,
    after: Observation | None,
    robot: Robot,
    station: Station,
) -> Verdict:
    """Return the verdict on a finished execution of a grasp (``execution.stopped_in`` is None).

    Every criterion must hold during the whole hold: width, load, and the object gone from its place, where the second
    capture sees that; the width also on every way with the object. What turned flush in the jaw may lose width, if it
    keeps it; what is too light for the arm to weigh is held when its place is seen empty. What is held must not be more
    than one thing explains.

    Args:
        after: the second capture; None when there was none, because `is_clear`.

    Raises: ValueError for an execution that did not reach its hold, and met nothing.
    """
    grasped, contact = execution.grasped, execution.contact
    if grasped is None:
        if contact is not None:
            return _went_back(contact, execution)
        raise ValueError("verify needs an execution that reached its hold")
    felt, cleared = _felt(execution.runs, robot), None
    was = corrected(before, detections.scene.mount)
    now = None if after is None else corrected(after, detections.scene.mount)
    if now is not None:
        cleared = _cleared(detections, grasp, was, now, station)
    place = f"{(cleared or 0.0) * 100:.0f} % of its place is empty"
    if cleared is None:
        place = "its place was not " + ("looked at" if after is None else "seen")
    held = (None, f"Held {min(felt.widths_m) * 1e3:.1f} mm wide, {felt.load_n:.2f} N heavy; {place}.")
    code, reason = _not_between(grasped, felt, station) or _not_lifted(felt, cleared, station) or held
    many = several(detections, grasp, grasped, felt.load_n, (was, now), station) if code is None else None
    if many is not None:
        code, reason = Code.MULTI_PICK, f"{many.reason} {reason}"
    if contact is not None:
        reason = f"{reason} {contact.in_words}, and the fingers closed there."
    return Verdict(
        held=code is None,
        code=code,
        reason=reason,
        hold_s=float(sum(run.motion.t_s[-1] for run in execution.runs if run.name == "hold")),
        width_min_m=min(felt.widths_m),
        load_n=felt.load_n,
        cleared_fraction=cleared,
        carried_n=felt.carried_n if execution.began is not None else None,
        several_by=many.witnesses if many is not None else (),
        also_gone=many.also_gone if many is not None else (),
    )


def _went_back(contact: Contact, execution: Execution) -> Verdict:
    """The verdict when the arm met something where the fingers could not close, and went back."""
    least_mm = contact.closes_within_m * 1e3
    why = f"too far: from {least_mm:.1f} mm on their tips reach it" if least_mm > 0 else "too far for their tips"
    if contact.remaining_m <= contact.closes_within_m:
        why = "but there was no free way up from there"
    return Verdict(
        held=False,
        code=Code.CONTACT,
        reason=f"{contact.in_words}, {why}; it stopped and went back.",
        hold_s=0.0,
        width_min_m=min(run.hand.width_m for run in execution.runs),
        load_n=0.0,
        cleared_fraction=None,
    )


def is_clear(
    grasp: Grasp,
    grasped: HandState,
    runs: Sequence[SegmentRun],
    robot: Robot,
    station: Station,
    one: Callable[[], OneThing] | None = None,
) -> bool:
    """Whether width and load tell by themselves how the pick went, so that a look at the place would change nothing.

    They do when the fingers lost it; and when they stand, and stay, where they should on that object, and its load is
    far from the measurement's errors, and the same in the hold as on the way there: nothing hangs on it, or fell off.

    Nor may it be open whether it is more than one.

    Args:
        runs: to the end of the hold.
        one: measures what the object alone explains, when the rest is clear; None = not known.
    """
    need, felt = station.verify, _felt(runs, robot)
    if _not_between(grasped, felt, station) is not None:
        return True
    is_as_planned = abs(grasped.width_m - grasp.width_m) <= need.clear_width_m
    is_steady = grasped.width_m - min(felt.widths_m) <= need.max_width_loss_m
    is_heavy = min(felt.load_n, felt.carried_n) >= max(need.clear_load_n, need.min_load_n)
    is_same = abs(felt.carried_n - felt.load_n) <= max(need.clear_load_n, _SAME_LOAD * felt.load_n)
    if not (is_as_planned and is_steady and is_heavy and is_same):
        return False
    return one is None or not may_be_several(one(), felt.load_n, station)


def _cleared(
    detections: Detections, grasp: Grasp, was: Observation, now: Observation, station: Station
) -> float | None:
    """As `cleared_fraction`; of a thing that may be several, at least the part that the pads held must have left."""
    cleared = cleared_fraction(detections, grasp.instance, was, now, station)
    if cleared is None or cleared >= station.verify.min_cleared_fraction:
        return cleared
    whole = Sight(*surroundings(was, detections.scene.labels == grasp.instance))
    parts = held_parts([whole], grasp.base_from_tcp, grasp.width_m)
    if parts is None:
        return cleared
    part_base = parts[0].points_base[parts[0].target]
    return cleared_fraction(detections, grasp.instance, was, now, station, part_base)


class _Felt(NamedTuple):
    """Measurements of hand and arm with the object: the widths and the load in the hold, and on every way."""

    held_m: list[float]
    on_the_way_m: list[float]
    load_n: float
    carried_n: float

    @property
    def widths_m(self) -> list[float]:
        return self.on_the_way_m + self.held_m


def _felt(runs: Sequence[SegmentRun], robot: Robot) -> _Felt:
    def motions(name: str) -> list[Motion]:
        return [run.motion for run in runs if run.name == name]

    held_m = [run.hand.width_m for run in runs if run.name == "hold"]
    on_the_way_m = [state.width_m for run in runs for state in run.hand_meanwhile]
    on_the_way_m += [run.hand.width_m for run in runs if run.name in ONLY_TO_LOOK]
    empty_n = _weight_n(motions("reach"), slice(None, _HEAD), robot)
    load_n = _weight_n(motions("hold"), slice(-_TAIL, None), robot) - empty_n
    return _Felt(held_m, on_the_way_m, load_n, _weight_n(motions("carry"), slice(None), robot) - empty_n)


def _not_between(grasped: HandState, felt: _Felt, station: Station) -> tuple[Code, str] | None:
    """Code and text when the widths tell that nothing is between the fingers, or not what they closed on."""
    need, width_min_m = station.verify, min(felt.widths_m)
    has_turned = felt.load_n >= need.min_load_n and max(felt.held_m) - min(felt.held_m) < _STEADY_M
    if grasped.width_m < need.min_width_m:
        return Code.GRASP_MISSED, f"The fingers closed to {grasped.width_m * 1e3:.1f} mm: nothing between them."
    has_lost = grasped.width_m - width_min_m > need.max_width_loss_m
    if width_min_m < need.min_width_m or (has_lost and not has_turned):
        return Code.DROPPED, (
            f"The width fell from {grasped.width_m * 1e3:.1f} to {width_min_m * 1e3:.1f} mm after the grasp."
        )
    opened = opened_by_another(grasped, max(felt.widths_m), station)
    return (Code.DROPPED, opened) if opened else None


def _not_lifted(felt: _Felt, cleared: float | None, station: Station) -> tuple[Code, str] | None:
    """Code and text when the load and the object's place tell that it did not come along."""
    need = station.verify
    is_heavy = felt.load_n >= need.min_load_n
    if not is_heavy and (cleared is None or cleared < need.min_cleared_fraction):
        return Code.DROPPED, f"The arm carries {felt.load_n:.2f} N; at least {need.min_load_n:.2f} N were expected."
    if cleared is not None and cleared < need.min_cleared_fraction:
        return Code.NOT_CLEARED, f"Only {cleared * 100:.0f} % of where the object lay is empty now."
    return None


def _weight_n(motions: list[Motion], samples: slice, robot: Robot) -> float:
    """Mean downward force at the tcp over some samples of each motion [N]."""
    forces = [
        -robot.tcp_force_n(q_rad, tau_ext_nm)[2]
        for motion in motions
        for q_rad, tau_ext_nm in zip(motion.q_rad[samples], motion.tau_ext_nm[samples], strict=True)
    ]
    return float(np.mean(forces))


def opened_by_another(grasped: HandState, width_m: float, station: Station) -> str:
    """Return why a hand at ``width_m`` does not hold what it ``grasped``, or "": closing fingers never open for it."""
    if width_m <= grasped.width_m + station.verify.max_width_loss_m:
        return ""
    return (
        f"The hand opened from {grasped.width_m * 1e3:.1f} to {width_m * 1e3:.1f} mm while it held the object:"
        " somebody else moved it."
    )


def lost_on_the_way(grasped: HandState, before_release: HandState, station: Station) -> str:
    """Return why the object was not in the hand before the release, or ""."""
    if before_release.width_m < station.verify.min_width_m:
        return f"The fingers were closed ({before_release.width_m * 1e3:.1f} mm) before the object was laid down."
    return opened_by_another(grasped, before_release.width_m, station)
