"""Plans every motion of one pick from ranked grasps.

``reach`` goes to the object along the approach line, ``carry`` up the lift line to where the object is held
(`planning.delivery`), ``place`` into the tray, and ``home`` back. The first way to grasp for which all of them are free
and within the limits is taken; every earlier one keeps the reason of its rejection. Same inputs, same bits.
Explanation: docs/planning.md; frames: docs/frames.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, Transform
from bus.codes import PLACE_OUT_OF_REACH, PLACE_TAKEN, Code
from bus.errors import CycleFailure
from bus.messages import Grasp, PickPlan, Segment
from bus.rejection import Rejection
from planning.budget import Budget
from planning.candidates import Approach, approaches, grasp_pose, is_like
from planning.carry import keeps_level
from planning.delivery import (
    aside_and_return,
    carry_to_tray,
    carry_to_view,
    lower_and_home,
    place_and_home,
    view_configuration,
)
from planning.infeasible import Infeasible
from planning.motion import Way, motion
from planning.obstacle import in_the_way
from planning.pregrasp import Pregrasp, approach_begins, first_that_works, opening_m, pregrasps_of, ways
from planning.scene import BESIDE_M, NEAR_M, Scene
from planning.slow_end import slow_end

Array = npt.NDArray[np.float64]


def plan_pick(
    scene: Scene,
    grasps: Sequence[Grasp],
    q_now_rad: Joints,
    missed: Sequence[Transform] = (),
    scene_of: Callable[[Grasp], Scene] | None = None,
    part_of: Callable[[Grasp], Scene | None] | None = None,
) -> PickPlan:
    """Choose the first feasible of ``grasps`` (best first) and plan every motion of its pick.

    Args:
        scene: the obstacles, the robot and its station.
        q_now_rad: (joints,) the arm's position at rest.
        missed: ``base_from_tcp`` (4, 4) of grasps that closed on nothing, or met
            something, before; grasps like them are left out.
        scene_of: the scene in which a grasp's own object is the target, all others are obstacles; None = ``scene``.
        part_of: the scene in which only the part of that object that hangs in the hand for certain is the target, for
            a grasp that the rest of it is in the way of; None = there is none.

    Raises:
        CycleFailure: NO_GRASP without grasps, or when all are like a missed one; MOTION_REFUSED or COLLISION when the
            arm cannot start from here; UNREACHABLE or COLLISION when no grasp is feasible, with the rejected ones.
    """
    _check_start(scene, q_now_rad)
    if not grasps:
        raise CycleFailure(Code.NO_GRASP, "There is no grasp to plan for.")
    reasons: dict[int, Infeasible] = {}
    rejected = [
        Rejection(grasp=index, tilt_rad=0.0, code=Code.GRASP_MISSED, reason="one like it failed before")
        for index, grasp in enumerate(grasps)
        if any(is_like(grasp.base_from_tcp, pose) for pose in missed)
    ]
    if len(rejected) == len(grasps):
        text = f"All {len(grasps)} grasps are like one that failed before."
        raise CycleFailure(Code.NO_GRASP, text, rejected)
    left_out = {rejection.grasp for rejection in rejected}
    scenes = _Scenes(scene_of or (lambda _: scene), part_of or (lambda _: None))
    left, budget = approaches(grasps, scene.station, left_out), Budget(scene.station.planning.budget_s)
    while left and not budget.is_over:
        approach = left.pop(0)
        try:
            segments = _plan_in_one_of(scenes, approach, np.asarray(q_now_rad), budget)
        except Infeasible as why:
            reasons[len(rejected)] = why
            rejected.append(
                Rejection(grasp=approach.index, tilt_rad=approach.tilt_rad, code=why.code, reason=why.reason)
            )
            continue
        return PickPlan(grasp=approach.index, tilt_rad=approach.tilt_rad, segments=segments, rejected=tuple(rejected))
    tried = [_with_obstacle(one, reasons.get(index)) for index, one in enumerate(rejected)]
    raise _none_feasible(tried, len(left), [why.code for why in reasons.values() if why.of_place])


@dataclass(frozen=True)
class _Scenes:
    """The scenes of each grasp: the whole object is the target, or only the part of it that is held for certain."""

    whole_of: Callable[[Grasp], Scene]
    part_of: Callable[[Grasp], Scene | None]
    parts: dict[int, Scene | None] = field(default_factory=dict)

    def part(self, approach: Approach) -> Scene | None:
        """The second one, made once for each grasp."""
        if approach.index not in self.parts:
            self.parts[approach.index] = self.part_of(approach.grasp)
        return self.parts[approach.index]


def _plan_in_one_of(scenes: _Scenes, approach: Approach, q_now_rad: Joints, budget: Budget) -> tuple[Segment, ...]:
    """Plan with the whole object in the hand; where that touches something, with the part that hangs in it for certain.

    Raises: Infeasible.
    """
    try:
        whole = scenes.whole_of(approach.grasp)
        budget.watch(whole.effort)
        return plan_approach(whole, approach, q_now_rad)
    except Infeasible as why:
        part = scenes.part(approach) if why.code is Code.COLLISION else None
        if part is None:
            raise
        budget.watch(part.effort)
        return plan_approach(part, approach, q_now_rad)


def plan_approach(scene: Scene, approach: Approach, q_now_rad: Joints) -> tuple[Segment, ...]:
    """Plan every motion of the pick by one approach, from ``q_now_rad`` (joints,). Raises: Infeasible."""
    base_from_tcp = grasp_pose(approach, scene.station)
    view_q = view_configuration(scene.empty(), base_from_tcp[:3, 3])
    past = _past_the_tray if scene.station.verify.look == "auto" else _past_the_viewpoint
    return past(scene, approach.grasp, base_from_tcp, q_now_rad, view_q)


def plan_reach(scene: Scene, approach: Approach, q_now_rad: Joints) -> Segment:
    """Plan only the first motion, from ``q_now_rad`` (joints,). Raises: Infeasible."""
    grasp, base_from_tcp = approach.grasp, grasp_pose(approach, scene.station)
    ways_to_grasp = _ways_to_grasp(scene, grasp, base_from_tcp, q_now_rad, lambda _: True)
    return first_that_works(ways_to_grasp, lambda way, pregrasp: _reach(scene, grasp, way, pregrasp))


def _check_start(scene: Scene, q_now_rad: Joints) -> None:
    if not np.isfinite(q_now_rad).all():
        raise CycleFailure(Code.MOTION_REFUSED, "The measured joint positions are not finite numbers.")
    beyond = scene.robot.arm.limits.outside(q_now_rad)
    if beyond is not None:
        raise CycleFailure(Code.MOTION_REFUSED, f"The arm cannot start from where it is: {beyond}.")
    collision = scene.collision(q_now_rad, None)
    if collision is not None:
        raise CycleFailure(Code.COLLISION, f"The arm cannot start from where it is: {collision}.")


def _with_obstacle(rejection: Rejection, why: Infeasible | None) -> Rejection:
    """The rejection with what was in the way: measured only where nothing else is left to be done."""
    return rejection if why is None else rejection.model_copy(update={"obstacle": why.obstacle()})


def _none_feasible(rejected: Sequence[Rejection], untried: int, of_place: Sequence[Code]) -> CycleFailure:
    """The failure without a feasible way. ``of_place``: the codes of the ways that end at the place."""
    counts = Counter(r.reason for r in rejected).most_common()
    reasons = "; ".join(f"{count} x {reason}" for reason, count in counts)
    code = Code.COLLISION if any(r.code is Code.COLLISION for r in rejected) else Code.UNREACHABLE
    over = f" {untried} more were not tried: planning.budget_s is over." if untried else ""
    text = f"None of {len(rejected)} ways to grasp is feasible: {reasons}.{over}"
    if code is Code.UNREACHABLE:
        advice = PLACE_OUT_OF_REACH if of_place else ""
    else:
        advice = PLACE_TAKEN if 2 * of_place.count(Code.COLLISION) > len(rejected) else ""
    return CycleFailure(code, text, rejected, advice=advice)


# --- all the way ------------------------------------------------------------------------------------------------------


def _past_the_viewpoint(
    scene: Scene, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints, view_q: Joints
) -> tuple[Segment, ...]:
    def make(way: Way, pregrasp: Pregrasp) -> tuple[Segment, Segment, Transform]:
        reach, grasped_at = _reach(scene, grasp, way, pregrasp), _grasped_at(scene, pregrasp)
        return reach, carry_to_view(scene.holding(grasped_at), grasp, pregrasp.leave_rad, view_q), grasped_at

    to_grasp = _ways_to_grasp(scene, grasp, base_from_tcp, q_now_rad, _calm(scene, view_q))
    reach, carry, grasped_at = first_that_works(to_grasp, make)
    return reach, carry, *place_and_home(scene.holding(grasped_at), grasp, grasped_at, view_q)


def _past_the_tray(
    scene: Scene, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints, view_q: Joints
) -> tuple[Segment, ...]:
    def make(way: Way, pregrasp: Pregrasp) -> tuple[Segment, Segment, Pregrasp, Scene]:
        reach, grasped_at = _reach(scene, grasp, way, pregrasp), _grasped_at(scene, pregrasp)
        holding = scene.holding(grasped_at)
        return reach, *carry_to_tray(holding, grasp, grasped_at, pregrasp.leave_rad, view_q), holding

    to_grasp = _ways_to_grasp(scene, grasp, base_from_tcp, q_now_rad, _calm(scene, view_q))
    reach, carry, above, holding = first_that_works(to_grasp, make)
    others = *lower_and_home(holding, grasp, above), *aside_and_return(holding, grasp, above, view_q)
    return reach, carry, *others


def _calm(scene: Scene, view_q: Joints) -> Callable[[Pregrasp], bool]:
    """Return whether the straight line from a lift's end to the viewpoint (joints,) keeps the object level.

    Above the tray, too: configurations near the viewpoint's make the ways between all of them level and short.
    """
    return lambda pregrasp: keeps_level(scene.robot, pregrasp.leave_rad[-1], view_q)


# --- reach ------------------------------------------------------------------------------------------------------------


def _grasped_at(scene: Scene, pregrasp: Pregrasp) -> Transform:
    """Return ``base_from_tcp`` (4, 4) of the grasp: as given, or half a turn from it."""
    return scene.robot.base_from_tcp(pregrasp.line_rad[-1])


def _ways_to_grasp(
    scene: Scene, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints, calm: Callable[[Pregrasp], bool]
) -> Iterator[tuple[Way, Pregrasp]]:
    pregrasps = pregrasps_of(scene, grasp, base_from_tcp, q_now_rad)
    return ways(scene.on_the_way(), q_now_rad, pregrasps, None, calm)


def _reach(scene: Scene, grasp: Grasp, way: Way, pregrasp: Pregrasp) -> Segment:
    """Plan the reach: up to the approach line the hand may still be on its way to its opening."""
    way_there, opens_m = scene.on_the_way(), opening_m(grasp, scene.station)
    near, beside = (partial(scene.is_near, width_m=opens_m, within_m=within_m) for within_m in (NEAR_M, BESIDE_M))
    felt = slow_end(scene.robot, pregrasp.line_rad, scene.station.execute, near, beside)
    reach = motion("reach", way, [*way.lines(), pregrasp.line_rad], way_there, opens_m, slow_end=felt)
    until = approach_begins(scene.robot, reach.trajectory, scene.station.planning.approach_m)
    collision = scene.gate(reach.trajectory.filtered()[: until + 1], None)
    if collision is not None:
        raise in_the_way("reach, at another width", collision, way_there, None)
    return reach
