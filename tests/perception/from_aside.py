"""Made-up scenes of boxes on a table, seen from any side, by ray casting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.messages import ArmMode, ArmState, CameraModel, Frame, Observation, View
from config.load import load_station
from perception.geometry.depth import rays
from planning.viewpoints import looking_at

CAMERA = CameraModel(width=320, height=288, fx=252.0, fy=252.0, cx=159.5, cy=143.5)
LOOKED_AT_M = np.array([0.46, 0.0, 0.03])
ABOVE, LEFT, RIGHT = (0.0, 0.0), (45.0, 120.0), (45.0, 240.0)
"""Tilt and azimuth [deg] of the direction to the camera, as the arm takes them."""
_STATION = load_station()
_TABLE_RGB = (165, 165, 165)

Array = np.ndarray


class Solid(NamedTuple):
    """A box: the middle of its foot and its size [m], and its colour; without depth, it is seen in colour.

    It is upright, or turned about the line through its foot along y, away from the arm.
    """

    foot_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    rgb: tuple[int, int, int] = (200, 60, 40)
    has_depth: bool = True
    leans_rad: float = 0.0

    def from_base(self) -> Array:
        """Rotation (3, 3) into the axes of the box."""
        c, s = np.cos(self.leans_rad), np.sin(self.leans_rad)
        return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def look(
    solids: Sequence[Solid],
    direction: tuple[float, float] = ABOVE,
    *,
    distance_m: float = 0.65,
    noise_m: float = 0.0,
    base_from_base: Array | None = None,
) -> Observation:
    """Return what the wrist camera sees from a direction.

    Args:
        noise_m: standard deviation of the depth; the same for the same direction.
        base_from_base: (4, 4) where everything seen is believed to be.
    """
    base_from_color = looking_at(LOOKED_AT_M, distance_m, *direction, roll_deg=0.0)
    along = rays(CAMERA).astype(float) @ base_from_color[:3, :3].T
    hits = np.stack(
        [_table(base_from_color[:3, 3], along), *(_entry(one, base_from_color[:3, 3], along) for one in solids)]
    )
    owner, depth_m = hits.argmin(axis=0), hits.min(axis=0)
    rng = np.random.default_rng([round(angle) for angle in direction])
    color = np.array([_TABLE_RGB, *(one.rgb for one in solids)], float)[owner] + rng.normal(0, 2, (*owner.shape, 3))
    depth_m = depth_m + rng.normal(0, 1, depth_m.shape) * noise_m
    blind = np.isin(owner, [1 + index for index, one in enumerate(solids) if not one.has_depth])
    depth_m[blind | (depth_m < (_STATION.camera.least_range_m))] = np.nan
    frame = Frame(
        stamp_ns=1,
        color=np.clip(color, 0, 255).astype(np.uint8),
        depth_m=depth_m.astype(np.float32),
        color_camera=CAMERA,
        depth_camera=CAMERA,
        color_from_depth=np.eye(4),
    )
    still = np.zeros(7)
    arm = ArmState(
        stamp_ns=1, mode=ArmMode.IDLE, q_rad=np.array(_STATION.arm.capture_q_rad), dq_rad_s=still, tau_ext_nm=still
    )
    pose = base_from_color if base_from_base is None else base_from_base @ base_from_color
    return Observation(view=View(stamp_ns=1, arm=arm, base_from_color=pose), frame=frame)


def _table(start_m: Array, along: Array) -> Array:
    """Distances (h, w) along rays whose z in the camera is 1, so that they are depths."""
    return np.asarray(np.where(along[..., 2] < -0.05, -start_m[2] / np.minimum(along[..., 2], -0.05), 5.0))


def _entry(one: Solid, start_m: Array, along: Array) -> Array:
    start_m, along = one.from_base() @ (start_m - one.foot_m), along @ one.from_base().T
    low = -np.array([one.size_m[0] / 2, one.size_m[1] / 2, 0.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = (low - start_m) / along, (low + one.size_m - start_m) / along
    enter, leave = np.minimum(*walls).max(axis=-1), np.maximum(*walls).min(axis=-1)
    return np.where(enter < leave, enter, np.inf)
