"""Stage 3, plan: from ranked grasps to executable motions (`planning.pick`). Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

from bus.arrays import Transform
from bus.cancel import Cancel
from bus.messages import Detections, Grasp, Observation, PickPlan
from config.schema import Station
from perception.fusion.agreed import corrected
from perception.scene.surroundings import surroundings
from planning.height_field import Sight
from planning.held_part import held_parts
from planning.pick import plan_pick
from planning.robot import Robot
from planning.scene import Scene


def plan(
    detections: Detections,
    looks: Sequence[Observation],
    robot: Robot,
    station: Station,
    missed: tuple[Transform, ...] = (),
    cancel: Cancel | None = None,
) -> PickPlan:
    """Return the first feasible way to grasp and its motions, among the known boxes and the observed points.

    Args:
        looks: what was detected in; the arm rests where the last one was taken.
        missed: base_from_tcp (4, 4) of grasps to leave out, because they failed before.
        cancel: ends the planning.

    Raises: CycleFailure (NO_GRASP, UNREACHABLE, COLLISION, MOTION_REFUSED; STOPPED by ``cancel``).
    """

    sights_of = _sights(detections, looks)

    def part_of(grasp: Grasp) -> Scene | None:
        parts = held_parts(sights_of(grasp.instance), grasp.base_from_tcp, grasp.width_m)
        return None if parts is None else Scene.of(robot, station, *parts, cancel=cancel)

    scene_of, grasps = _aimed(sights_of, robot, station, cancel), detections.grasps
    return plan_pick(scene_of(grasps[0]), grasps, looks[-1].view.q_rad, missed, scene_of, part_of)


def scenes(
    detections: Detections, looks: Sequence[Observation], robot: Robot, station: Station, cancel: Cancel | None = None
) -> Callable[[Grasp], Scene]:
    """Return what gives the scene of a grasp: its own thing is the target, the others are obstacles. Args as `plan`."""
    return _aimed(_sights(detections, looks), robot, station, cancel)


def _sights(detections: Detections, looks: Sequence[Observation]) -> Callable[[int], list[Sight]]:
    """Return what gives the looks with one thing as the target."""

    @cache
    def sights_of(instance: int) -> list[Sight]:
        return [
            Sight(*surroundings(corrected(look, detections.scene.mount), labels == instance), look.view.q_rad)
            for look, labels in zip(looks, detections.scene.look_labels, strict=True)
        ]

    return sights_of


def _aimed(
    sights_of: Callable[[int], list[Sight]], robot: Robot, station: Station, cancel: Cancel | None
) -> Callable[[Grasp], Scene]:
    @cache
    def aimed_at(instance: int) -> Scene:
        return Scene.of(robot, station, *sights_of(instance), cancel=cancel)

    return lambda grasp: aimed_at(grasp.instance)
