"""Pinhole projection of undistorted images: pixels to points and back. Frames and units: docs/frames.md."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.messages import CameraModel

Array = npt.NDArray[np.float64]


def lift(mask: npt.NDArray[np.bool_], depth_m: npt.NDArray[np.float32], camera: CameraModel) -> Array:
    """Points (n, 3) [m] in the camera frame of the masked pixels that have depth, in row-major order."""
    v, u = np.nonzero(mask & np.isfinite(depth_m))
    return lift_pixels(np.stack([u, v], axis=1).astype(float), depth_m[v, u].astype(float), camera)


def lift_pixels(pixels_px: Array, depth_m: Array, camera: CameraModel) -> Array:
    """Points (n, 3) [m] in the camera frame of pixels (n, 2) = (u, v) at z-depth ``depth_m`` (n,)."""
    x = (pixels_px[:, 0] - camera.cx) / camera.fx * depth_m
    y = (pixels_px[:, 1] - camera.cy) / camera.fy * depth_m
    return np.stack([x, y, depth_m], axis=1)


def project(points: Array, camera: CameraModel) -> Array:
    """Pixels (n, 2) = (u, v) of points (n, 3) [m] in front of the camera."""
    return np.stack(
        [
            points[:, 0] / points[:, 2] * camera.fx + camera.cx,
            points[:, 1] / points[:, 2] * camera.fy + camera.cy,
        ],
        axis=1,
    )


def subsample(points: Array, most: int) -> Array:
    """At most ``most`` of the points (n, 3), at a constant stride."""
    return points[:: max(1, -(-len(points) // most))]


def subsample_float32(points: Array, most: int) -> npt.NDArray[np.float32]:
    """At most ``most`` of the points (n, 3) as float32, at a constant stride; for display and recording."""
    return np.asarray(subsample(points, most), dtype=np.float32)
