"""Stage 3, plan: from ranked grasps to motions that may be executed (`planning.pick`). Pure."""

from __future__ import annotations

from bus.messages import Detections, Observation, PickPlan
from config.schema import Station
from planning.pick import plan_pick
from planning.robot import Robot


def plan(detections: Detections, observation: Observation, robot: Robot, station: Station) -> PickPlan:
    """The first feasible grasp and its motions. Raises: CycleFailure (UNREACHABLE, COLLISION)."""
    return plan_pick(robot, station, detections.grasps, observation.view.arm.q_rad)
