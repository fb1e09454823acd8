"""The grasp candidates, best first, and the arm configurations that reach them. Frames: docs/frames.md."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bus.arrays import Joints, Transform
from bus.codes import Code
from bus.messages import Grasp
from bus.transforms import apply
from config.franka_hand import FINGER_TIP_M, FINGER_TIP_SIZE_M
from config.schema import Station
from planning.arm import Arm, cost
from planning.infeasible import Infeasible
from planning.robot import flange_pose
from planning.scene import FINGER_CLEARANCE_M
from planning.search import LIMIT_MARGIN_RAD

MAX_RAISE_M = 0.015
"""Largest raise of a grasp that keeps the finger tips off the table; more would miss the object."""
LIKE_M, LIKE_RAD = 0.012, 0.35
"""Two grasps whose positions and closing axes differ by less are the same grasp."""
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Approach:
    """One grasp from one direction.

    Attributes:
        index: of the grasp. ``tilt_rad``: turn about the closing axis from the direction that perception proposed.
    """

    index: int
    grasp: Grasp
    tilt_rad: float

    @property
    def score(self) -> float:
        """The grasp's score times the cosine of the tilt."""
        return self.grasp.score * float(np.cos(self.tilt_rad))


def approaches(grasps: Sequence[Grasp], station: Station, left_out: Collection[int] = ()) -> list[Approach]:
    """Return every grasp from every direction, best first, without the indices in ``left_out``.

    At most ``planning.max_approaches`` are returned.
    """
    tilts_rad = np.radians(station.planning.tilts_deg)
    kept = [(i, grasp) for i, grasp in enumerate(grasps) if i not in left_out]
    every = [Approach(i, grasp, float(tilt)) for i, grasp in kept for tilt in tilts_rad]
    return sorted(every, key=lambda one: -one.score)[: station.planning.max_approaches]


def is_like(base_from_tcp: Transform, other: Transform) -> bool:
    """Whether two grasps (4, 4) close at the same place along the same axis, whatever their approach direction."""
    away_m = float(np.linalg.norm(base_from_tcp[:3, 3] - other[:3, 3]))
    return away_m < LIKE_M and abs(float(base_from_tcp[:3, 1] @ other[:3, 1])) > np.cos(LIKE_RAD)


def grasp_pose(approach: Approach, station: Station) -> Transform:
    """Return ``base_from_tcp`` (4, 4) of an approach, raised as far as its finger tips need to clear the table.

    Raises:
        Infeasible: the grasp is not a pose, wider than the jaw, or too low.
    """
    grasp = approach.grasp
    _require_pose(grasp)
    if grasp.width_m > station.hand.max_width_m:
        raise Infeasible(
            Code.NO_GRASP,
            f"width: {grasp.width_m * 1e3:.0f} mm are wider than the jaw opens ({station.hand.max_width_m * 1e3:.0f})",
        )
    c, s = np.cos(approach.tilt_rad), np.sin(approach.tilt_rad)
    turn = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return _off_the_table(np.asarray(grasp.base_from_tcp) @ turn, grasp.opening_m, station)


def configurations(arm: Arm, poses: Sequence[Transform], q_from_rad: Joints) -> Iterator[tuple[Joints, Transform]]:
    """Yield (q_rad (n,), pose) for every arm configuration that brings the tcp to one of ``poses``, cheapest first.

    Configurations near a joint limit are left out.

    Args:
        poses: ``base_from_tcp``, each (4, 4).
        q_from_rad: (joints,) start, from which the cost counts.
    """
    q, owner = arm.solutions(flange_pose(np.stack(poses)), LIMIT_MARGIN_RAD)
    for index in np.argsort(cost(arm, q_from_rad, q), kind="stable"):
        yield q[index], poses[owner[index]]


def twins(base_from_tcp: Transform) -> list[Transform]:
    """Return the pose (4, 4) and the one half a turn about the approach axis away: a parallel hand has no front."""
    return [base_from_tcp, base_from_tcp @ _HALF_TURN]


def _require_pose(grasp: Grasp) -> None:
    pose = grasp.base_from_tcp
    if not (np.isfinite(pose).all() and np.isfinite([grasp.width_m, grasp.opening_m, grasp.score]).all()):
        raise Infeasible(Code.UNREACHABLE, "the grasp is not made of finite numbers")
    rotation = pose[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise Infeasible(Code.UNREACHABLE, "the grasp's orientation is not a rotation")


def _off_the_table(pose: Transform, opening_m: float, station: Station) -> Transform:
    half_x, half_y = FINGER_TIP_SIZE_M[0] / 2, opening_m / 2 + FINGER_TIP_SIZE_M[1]
    corners = np.array([[x, y, FINGER_TIP_M] for x in (-half_x, half_x) for y in (-half_y, half_y)])
    lowest_m = float(apply(pose, corners)[:, 2].min())
    table_m = station.scene.table.center_m[2] + station.scene.table.size_m[2] / 2
    raise_m = table_m + FINGER_CLEARANCE_M + 5e-4 - lowest_m
    if raise_m > MAX_RAISE_M:
        raise Infeasible(Code.COLLISION, "the grasp is so low that the fingers would touch table")
    raised = pose.copy()
    raised[2, 3] += max(0.0, raise_m)
    return raised
