"""Looks again, from another place: when it is worth it, and how the camera gets there. Frames: docs/frames.md."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, Observation
from bus.trajectory import Trajectory
from bus.transforms import direction_of_view_deg
from cell.machine.gate import Gate
from config.scene import scene_boxes
from config.schema import Station
from drivers.interface import Arm
from perception.scene.surroundings import surroundings
from planning.height_field import Sight
from planning.looks import next_look, unseen
from planning.motion import move
from planning.robot import Robot
from planning.scene import Scene

_FOR_WANT_OF_SIGHT = {
    Code.NOT_SEEN: "too little was seen",
    Code.NO_DEPTH: "something has no depth",
    Code.TOO_NEAR: "something is too near to the camera",
    Code.NO_TABLE: "no table was seen",
    Code.TABLE_MOVED: "the table seems to lie elsewhere",
    Code.NO_GRASP: "there is no grasp",
    Code.COLLISION: "no way to grasp is free",
    Code.UNREACHABLE: "no way to grasp is reached",
}
"""Failures of detect and plan that another look may mend."""


def asked_for(station: Station) -> int:
    """Return how many looks are taken in any case."""
    views = station.capture.views
    return 1 if views == "auto" else views


def why_look_again(outcome: Detections | CycleFailure, looks: int, station: Station, *, is_hosted: bool = False) -> str:
    """Return why the arm should look once more, or "".

    Args:
        outcome: of detect or plan, from ``looks`` observations.
        is_hosted: the goal-image model is paid for each answer: a grasp that it gave is taken, however weak.
    """
    if station.capture.views != "auto" or looks >= station.capture.most_views:
        return ""
    if isinstance(outcome, CycleFailure):
        return _FOR_WANT_OF_SIGHT.get(outcome.failure, "")
    best = outcome.grasps[0].score
    is_weak = best < station.capture.weak_score and not is_hosted
    return f"the best grasp scores only {best:.2f}" if is_weak else ""


def way_to_next_look(
    looks: Sequence[Observation], robot: Robot, station: Station, cancel: Cancel | None = None
) -> Trajectory:
    """Return the motion to the next viewpoint about the middle of the pick region, from where the last look was taken.

    Raises: CycleFailure(UNREACHABLE, STOPPED).
    """
    taken = [direction_of_view_deg(look.view.base_from_color) for look in looks]
    scene = _among_unseen(looks, robot, station, cancel)
    return next_look(scene, looks[-1].view.q_rad, taken).motion


def way_back(looks: Sequence[Observation], robot: Robot, station: Station, cancel: Cancel | None = None) -> Trajectory:
    """Return the motion from the last look to the capture pose. Raises: CycleFailure."""
    scene = _among_unseen(looks, robot, station, cancel)
    return move(scene, looks[-1].view.q_rad, np.asarray(station.arm.capture_q_rad))


def go(arm: Arm, gate: Gate, way: Trajectory) -> None:
    """Move through the gate. Raises: CycleFailure(STOPPED) when it was stopped, or may not begin; as the arm."""
    with gate.motion() as may_begin:
        if may_begin and arm.execute(way).finished:
            return
    raise CycleFailure(Code.STOPPED, "Stopped on the way to another look.")


def _among_unseen(looks: Sequence[Observation], robot: Robot, station: Station, cancel: Cancel | None) -> Scene:
    """The obstacles of a look: what was observed, and all of the pick region, where more may stand than was seen."""
    sights = []
    for look in looks:
        nothing = np.zeros(look.frame.color.shape[:2], dtype=bool)
        sights.append(Sight(*surroundings(look, nothing), look.view.q_rad))
    return Scene.of(robot, station, *sights, boxes=(*scene_boxes(station.scene), unseen(station)), cancel=cancel)
