"""The view of the depth camera, in its own pixels: points, and whether a place in space was seen to be free."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import CameraModel, Observation
from bus.transforms import inverse
from perception.geometry.depth import moved, rays

_NARROW_M, _SHADOW_M, _STEP_M = 0.003, 0.016, 0.015
"""See `DepthView.nearest_m`: how far a narrow hole's rim is, how far a shadow reaches, what counts as a step."""
_STEEPER, _SPARSE = 1.7, 97
"""Seen from aside, a table recedes as much as a step does: a step is so many times more than what most pixels show."""
_RISES_M = 0.045
"""How far a thing may rise from what is seen beside it."""
_BEHIND_M = 0.004
"""A place is free when what is seen in its direction lies so much farther."""

Depth = npt.NDArray[np.float32]
Points = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]


@dataclass(frozen=True)
class DepthView:
    """The depth image without flying pixels.

    Attributes:
        depth_m: (h, w) z-depth, NaN = none. ``camera``: its model, with distortion.
        base_from_depth: (4, 4) pose of the depth camera.
        points_base: (h, w, 3) [m], NaN = none.
        least_range_m: the camera measures nothing nearer.
    """

    depth_m: Depth
    camera: CameraModel
    base_from_depth: Transform
    points_base: Points
    least_range_m: float = 0.0

    @classmethod
    def of(cls, observation: Observation, depth_m: Depth, least_range_m: float = 0.0) -> DepthView:
        """Return the depth image of an observation; ``depth_m`` (h, w): it, without flying pixels."""
        frame = observation.frame
        base_from_depth = observation.view.base_from_color @ frame.color_from_depth
        points = moved(_rays(frame.depth_camera) * depth_m[..., None], base_from_depth)
        return cls(depth_m, frame.depth_camera, base_from_depth, points, least_range_m)

    @cached_property
    def pixel_m(self) -> float:
        """Size of a pixel on the scene [m], at the median depth."""
        return float(np.nanmedian(self.depth_m[::4, ::4])) / self.camera.fx

    @cached_property
    def nearest_m(self) -> Depth:
        """(h, w) the measured depth; in holes, how near what fills them may be; NaN where nobody can say.

        A narrow hole is as near as its rim. A wider one beside a step is the shadow of what is near there, and counts
        as near as that. Any other hole may hide anything: glass, something black, or nearer than the camera measures.
        So may any hole beside what is almost as near as that: a bottle's neck rises from its shoulder.
        """
        is_hole = np.isnan(self.depth_m)
        rim_m = cv2.erode(np.where(is_hole, np.float32(np.inf), self.depth_m), _box(_NARROW_M, self.pixel_m))
        near_m = cv2.erode(np.where(is_hole, np.float32(np.inf), self.depth_m), _box(_SHADOW_M, self.pixel_m))
        far_m = cv2.dilate(np.where(is_hole, np.float32(0), self.depth_m), _box(_SHADOW_M, self.pixel_m))
        step_m = far_m - near_m
        is_step = step_m > max(_STEP_M, _STEEPER * float(np.median(step_m[~is_hole][::_SPARSE])))
        filled = np.where(is_step, near_m, rim_m)
        filled = np.where(is_hole, filled, self.depth_m)
        says_nothing = np.isinf(filled) | (is_hole & (near_m < self.least_range_m + _RISES_M))
        return np.where(says_nothing, np.float32(np.nan), filled)

    def in_view(self, points_base: Points) -> npt.NDArray[np.bool_]:
        """Whether each point (n, 3) [m] lies inside the image."""
        return self._within(*self._projected(points_base))

    def is_hidden(self, points_base: Points) -> npt.NDArray[np.bool_]:
        """Whether each point (n, 3) [m] lies behind what is seen in its direction, or nothing is seen there.

        Points outside the image are not hidden: they are not in view.
        """
        u, v, z = self._projected(points_base)
        inside = self._within(u, v, z)
        seen_m = self.nearest_m.ravel().take(np.where(inside, v * np.int32(self.camera.width) + u, 0))
        return np.asarray(inside & ~(seen_m > z + np.float32(_BEHIND_M)))  # NaN compares false

    def inside(self, pixels: npt.NDArray[np.int32], z: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
        """Whether pixels (n, 2) = (u, v) at z-depth (n,) lie inside the image, before the camera."""
        return self._within(pixels[:, 0], pixels[:, 1], z)

    def pixels(self, points_base: Points) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
        """Return the pixels (n, 2) = (u, v) nearest to points (n, 3) [m], maybe beyond the image, and their z-depth."""
        u, v, z = self._projected(points_base)
        return np.stack([u, v], axis=1), z

    def _within(self, u: Indices, v: Indices, z: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
        return np.asarray((z > 0) & (u >= 0) & (v >= 0) & (u < self.camera.width) & (v < self.camera.height))

    def _projected(self, points_base: Points) -> tuple[Indices, Indices, npt.NDArray[np.float32]]:
        """As `pixels`, columns (n,) and rows (n,) apart: the height maps spend most of their time here."""
        x, y, z = np.ascontiguousarray(moved(points_base[None], self._depth_from_base)[0].T)
        scale = 1 / np.where(z > 0, z, np.float32(np.nan))
        x, y = _distorted(x * scale, y * scale, self.camera)
        model = self.camera
        return _whole(model.fx * x + model.cx), _whole(model.fy * y + model.cy), z

    @cached_property
    def _depth_from_base(self) -> Transform:
        return inverse(self.base_from_depth)


def _whole(pixel: npt.NDArray[np.float32]) -> Indices:
    """The nearest whole numbers (n,) of pixel coordinates (n,), NaN = before the image."""
    bounded = np.minimum(np.fmax(np.rint(pixel), np.float32(-1)), np.float32(1 << 20))
    return np.asarray(bounded.astype(np.int32))


def _box(reach_m: float, pixel_m: float) -> npt.NDArray[np.uint8]:
    """A square kernel that reaches so far to each side."""
    side_px = 2 * int(np.ceil(reach_m / pixel_m)) + 1
    return np.ones((side_px, side_px), np.uint8)


@lru_cache(maxsize=4)
def _rays(camera: CameraModel) -> Points:
    return rays(camera).astype(np.float32)


def _distorted(
    x: npt.NDArray[np.float32], y: npt.NDArray[np.float32], camera: CameraModel
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Image coordinates, in focal lengths, after the lens's distortion (docs/frames.md)."""
    if not camera.distortion:
        return x, y
    k1, k2, p1, p2, k3, k4, k5, k6 = (np.float32(value) for value in (*camera.distortion, *(0.0,) * 8)[:8])
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )
