"""Stage 3, plan: from ranked grasps to executable motions (`planning.pick`). Pure."""

from __future__ import annotations

from functools import cache

from bus.arrays import Transform
from bus.cancel import Cancel
from bus.messages import Detections, Grasp, Observation, PickPlan
from config.schema import Station
from perception.scene.surroundings import surroundings
from planning.pick import plan_pick
from planning.robot import Robot
from planning.scene import Scene, Sight


def plan(
    detections: Detections,
    observation: Observation,
    robot: Robot,
    station: Station,
    missed: tuple[Transform, ...] = (),
    cancel: Cancel | None = None,
) -> PickPlan:
    """The first feasible way to grasp and its motions, among the known boxes and the observed points.

    Args:
        missed: base_from_tcp (4, 4) of grasps to leave out, because they closed on nothing before.
        cancel: ends the planning.

    Raises: CycleFailure (NO_GRASP, UNREACHABLE, COLLISION, MOTION_REFUSED; STOPPED by ``cancel``).
    """

    @cache
    def aimed_at(instance: int) -> Scene:
        points_base, target = surroundings(observation, detections.scene.labels == instance)
        return Scene.of(robot, station, Sight(points_base, target), cancel=cancel)

    def scene_of(grasp: Grasp) -> Scene:
        return aimed_at(grasp.instance)

    grasps = detections.grasps
    return plan_pick(scene_of(grasps[0]), grasps, observation.view.arm.q_rad, missed, scene_of)
