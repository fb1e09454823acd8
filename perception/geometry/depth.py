"""Makes one RGB-D image of a raw frame: colour undistorted, depth registered to it.

This is the *observed* depth estimator. Depth is z-depth in metres in the ``color`` frame; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import CameraModel, Frame
from bus.transforms import apply
from perception.geometry.lift import project

_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-9)
_FLYING_M = 0.008
_FLYING_NEIGHBOURS = 4
_SPLAT = ((0, 0), (0, 1), (1, 0), (1, 1))


@dataclass(frozen=True)
class Rgbd:
    """Colour and registered depth of one undistorted pinhole camera.

    Attributes:
        color: (H, W, 3) RGB.
        depth_m: (H, W) z-depth, NaN = invalid.
        camera: the pinhole, without distortion.
    """

    color: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32]
    camera: CameraModel


def register(frame: Frame) -> Rgbd:
    """Undistort the colour image and reproject the depth image into it; the nearest surface wins.

    A frame whose depth is registered already keeps its depth pixels. A depth pixel covers about 1.5 colour pixels (NFOV
    depth, 720p colour), so each is splatted onto 2 x 2 pixels.
    """
    camera = frame.color_camera.model_copy(update={"distortion": ()})
    color = frame.color
    if frame.color_camera.distortion:
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        color = np.asarray(cv2.undistort(np.asarray(color), matrix, np.array(frame.color_camera.distortion)))
    depth_m = without_flying_pixels(frame.depth_m)
    if frame.depth_camera == camera and np.array_equal(frame.color_from_depth, np.eye(4)):
        return Rgbd(color, depth_m, camera)
    valid = np.isfinite(depth_m)
    points = rays(frame.depth_camera)[valid] * depth_m[valid][:, None].astype(float)
    points = apply(frame.color_from_depth, points)
    return Rgbd(color, _splat(points, camera), camera)


def without_flying_pixels(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Depth (H, W) without flying pixels: those with fewer than 4 of 8 neighbours within 8 mm become NaN."""
    near = np.zeros(depth_m.shape, dtype=np.uint8)
    padded = np.pad(depth_m, 1, constant_values=np.nan)
    height, width = depth_m.shape
    for dv in range(3):
        for du in range(3):
            if (dv, du) != (1, 1):
                near += np.abs(padded[dv : dv + height, du : du + width] - depth_m) < _FLYING_M
    return np.where(near >= _FLYING_NEIGHBOURS, depth_m, np.nan).astype(np.float32)


@lru_cache(maxsize=4)
def rays(camera: CameraModel) -> npt.NDArray[np.float64]:
    """Undistorted rays (h, w, 3) with z = 1 of all pixels of a distorted camera."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    xy = cv2.undistortPoints(pixels, matrix, np.array(camera.distortion or (0.0,) * 4), criteria=_CRITERIA)[:, 0]
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1).reshape(camera.height, camera.width, 3)


def _splat(points: npt.NDArray[np.float64], camera: CameraModel) -> npt.NDArray[np.float32]:
    """Z-buffer (H, W) [m] of points (n, 3) in the camera frame."""
    corner = np.floor(project(points, camera)).astype(int)
    z = points[:, 2].astype(np.float32)
    nearest = np.full(camera.height * camera.width, np.inf, dtype=np.float32)
    for dv, du in _SPLAT:
        u, v = corner[:, 0] + du, corner[:, 1] + dv
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        np.minimum.at(nearest, (v * camera.width + u)[inside], z[inside])
    nearest[np.isinf(nearest)] = np.nan
    return nearest.reshape(camera.height, camera.width)
