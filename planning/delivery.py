"""Plans the ways with the object in hand, and the way home: past the viewpoint of the second capture, or to the tray.

The object is held at the viewpoint, or above the tray (``verify.look``).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples, Transform
from bus.codes import Code
from bus.messages import Grasp, Segment
from config.schema import Station
from planning.candidates import configurations
from planning.carry import keeps_level, within_max_tilt
from planning.infeasible import Infeasible
from planning.motion import Way, connect, motion
from planning.pregrasp import Pregrasp, first_that_works, preplaces, shifted, ways
from planning.scene import Scene

Array = npt.NDArray[np.float64]

_EXAMINED = 16  # arm configurations tried for a viewpoint


def view_configuration(scene: Scene, object_m: Array) -> Joints:
    """Return the viewpoint of the second capture: the first reachable pose aside of the capture pose, else that one."""
    robot, station = scene.robot, scene.station
    capture_q = np.array(station.arm.capture_q_rad)
    camera_m = robot.base_from_color(capture_q)[:2, 3]
    for aside_m in station.verify.look_aside_m:
        shift_m = np.append(object_m[:2] + aside_m - camera_m, 0.0)
        pose = shifted(robot.base_from_tcp(capture_q), shift_m)
        for q, _ in islice(configurations(robot.arm, [pose], capture_q), _EXAMINED):
            if scene.collision(q, None) is None:
                return q
    return capture_q


# --- held at the viewpoint --------------------------------------------------------------------------------------------


def carry_to_view(holding: Scene, grasp: Grasp, lift_rad: JointSamples, view_q: Joints) -> Segment:
    """Plan the way up the lift line (n, joints) and to the viewpoint (joints,). Raises: Infeasible."""
    may = within_max_tilt(holding.robot, lift_rad[-1], view_q)
    way = connect(holding, lift_rad[-1], [view_q], grasp.width_m, may)
    return _carry(holding, grasp, lift_rad, way)


def place_and_home(holding: Scene, grasp: Grasp, base_from_tcp: Transform, view_q: Joints) -> tuple[Segment, Segment]:
    """Plan the way from the viewpoint (joints,) above the tray and down, and the one home. Raises: Infeasible."""

    def make(way: Way, above: Pregrasp) -> tuple[Segment, Segment]:
        place = motion("place", way, [*way.lines(), above.line_rad], holding, grasp.width_m)
        return place, _home(holding.empty(), above)

    return first_that_works(_ways_to_tray(holding, grasp, base_from_tcp, view_q, view_q), make)


# --- held above the tray ----------------------------------------------------------------------------------------------


def carry_to_tray(
    holding: Scene, grasp: Grasp, base_from_tcp: Transform, lift_rad: JointSamples, view_q: Joints
) -> tuple[Segment, Pregrasp]:
    """Plan the way up the lift line (n, joints) and above the tray, and return where it ends. Raises: Infeasible.

    Args:
        view_q: (joints,) the viewpoint, to which the object may have to go from there.
    """

    def make(way: Way, above: Pregrasp) -> tuple[Segment, Pregrasp]:
        return _carry(holding, grasp, lift_rad, way), above

    return first_that_works(_ways_to_tray(holding, grasp, base_from_tcp, lift_rad[-1], view_q), make)


def lower_and_home(holding: Scene, grasp: Grasp, above: Pregrasp) -> tuple[Segment, Segment]:
    """Plan the way down into the tray, and the one home. Raises: Infeasible."""
    ends_rad = above.line_rad[[0, -1]]
    place = motion("place", Way(0, "straight", ends_rad), [above.line_rad], holding, grasp.width_m)
    return place, _home(holding.empty(), above)


def aside_and_return(holding: Scene, grasp: Grasp, above: Pregrasp, view_q: Joints) -> tuple[Segment, Segment]:
    """Plan the way from above the tray to the viewpoint (joints,), and the same way back. Raises: Infeasible."""
    may = within_max_tilt(holding.robot, above.q_rad, view_q)
    way = connect(holding, above.q_rad, [view_q], grasp.width_m, may)
    back = Way(0, way.route, way.points_rad[::-1])
    aside = motion("aside", way, way.lines(), holding, grasp.width_m)
    return aside, motion("return", back, back.lines(), holding, grasp.width_m)


# --- both -------------------------------------------------------------------------------------------------------------


def _carry(holding: Scene, grasp: Grasp, lift_rad: JointSamples, way: Way) -> Segment:
    return motion("carry", way, [lift_rad, *way.lines()], holding, grasp.width_m, leaving=holding.empty())


def _ways_to_tray(
    holding: Scene, grasp: Grasp, base_from_tcp: Transform, q_from_rad: Joints, view_q: Joints
) -> Iterator[tuple[Way, Pregrasp]]:
    def calm(above: Pregrasp) -> bool:
        return keeps_level(robot, q_from_rad, above.q_rad) and keeps_level(robot, view_q, above.q_rad)

    robot = holding.robot
    aboves = preplaces(holding, grasp, base_from_tcp, q_from_rad)
    may = within_max_tilt(robot, q_from_rad, q_from_rad)
    return ways(holding, q_from_rad, aboves, grasp.width_m, calm, may, _out_of_reach(holding.station))


def _out_of_reach(station: Station) -> Infeasible:
    """The reason where no arm configuration reaches the place: it is not the grasp's fault."""
    x, y, z = station.scene.place_m
    return Infeasible(Code.UNREACHABLE, f"the place ({x:.2f}, {y:.2f}, {z:.2f}) cannot be reached", of_place=True)


def _home(empty: Scene, above: Pregrasp) -> Segment:
    capture_q = np.array(empty.station.arm.capture_q_rad)
    back = connect(empty, above.leave_rad[-1], [capture_q], None)
    return motion("home", back, [above.leave_rad, *back.lines()], empty, None)
