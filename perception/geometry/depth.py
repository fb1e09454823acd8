"""Makes one RGB-D image of a raw frame: colour undistorted, depth registered to it.

This is the *observed* depth estimator. Depth is z-depth in metres in the ``color`` frame; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import CameraModel, Frame

_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-9)
_FLYING_M = 0.008
_FLYING_NEIGHBOURS = 4
_NOTHING = np.iinfo(np.int64).max
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


def undistorted(frame: Frame) -> npt.NDArray[np.uint8]:
    """Return the colour image (H, W, 3) of a frame as a pinhole of the same matrix sees it, RGB."""
    color = np.asarray(frame.color)
    if frame.color_camera.distortion:
        color = np.asarray(cv2.remap(color, *_undistortion(frame.color_camera), cv2.INTER_LINEAR))
    return color


def register(frame: Frame) -> Rgbd:
    """Return the RGB-D image of a frame; see `registered`."""
    return registered(frame, without_flying_pixels(frame.depth_m))[0]


def registered(frame: Frame, depth_m: npt.NDArray[np.float32]) -> tuple[Rgbd, npt.NDArray[np.int32]]:
    """Undistort the colour image and reproject the depth image into it; the nearest surface wins.

    A frame whose depth is registered already keeps its depth pixels. A depth pixel covers about 1.5 colour pixels (NFOV
    depth, 720p colour), so each is splatted onto 2 x 2 pixels.

    Args:
        depth_m: (h, w) of the frame, without flying pixels.

    Returns:
        The RGB-D image, and for each of its pixels (H, W) the flat index of its depth pixel, -1 = none.
    """
    camera = frame.color_camera.model_copy(update={"distortion": ()})
    color = undistorted(frame)
    valid = np.flatnonzero(np.isfinite(depth_m)).astype(np.int32)
    if frame.depth_camera == camera and np.array_equal(frame.color_from_depth, np.eye(4)):
        source = np.full(depth_m.size, -1, dtype=np.int32)
        source[valid] = valid
        return Rgbd(color, depth_m, camera), source.reshape(depth_m.shape)
    points = rays(frame.depth_camera).reshape(-1, 3)[valid].astype(np.float32) * depth_m.ravel()[valid][:, None]
    splat_m, nearest = _splat(moved(points[None], frame.color_from_depth)[0], camera)
    return Rgbd(color, splat_m, camera), _of(valid, nearest)


def moved(points: npt.NDArray[np.float32], to_from: Transform) -> npt.NDArray[np.float32]:
    """Points (h, w, 3) of a frame in another one, ``to_from`` (4, 4); fast, in single precision."""
    if points.size == 0:  # OpenCV has no empty images
        return points
    return np.asarray(cv2.transform(points, to_from[:3].astype(np.float32)))


def _of(valid: npt.NDArray[np.int32], nearest: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """The entries of ``valid`` (n,) at the indices ``nearest`` (H, W); -1 where these are -1."""
    return np.append(valid, np.int32(-1))[nearest]


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
def _undistortion(camera: CameraModel) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]:
    """OpenCV's maps, in fixed point, from the undistorted image (H, W) to the distorted one."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    size = (camera.width, camera.height)
    whole, part = cv2.initUndistortRectifyMap(
        matrix, np.array(camera.distortion), np.eye(3), matrix, size, cv2.CV_16SC2
    )
    return np.asarray(whole), np.asarray(part)


@lru_cache(maxsize=4)
def rays(camera: CameraModel) -> npt.NDArray[np.float64]:
    """Undistorted rays (h, w, 3) with z = 1 of all pixels of a distorted camera."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    if not camera.distortion:
        return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    xy = cv2.undistortPoints(pixels, matrix, np.array(camera.distortion), criteria=_CRITERIA)[:, 0]
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1).reshape(camera.height, camera.width, 3)


def _splat(
    points: npt.NDArray[np.float32], camera: CameraModel
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
    """Z-buffer (H, W) [m] of points (n, 3) in the camera frame, NaN = none; and the index of the point there, or -1."""
    x, y, z = points.T
    left = np.floor(x / z * np.float32(camera.fx) + np.float32(camera.cx)).astype(np.int32)
    top = np.floor(y / z * np.float32(camera.fy) + np.float32(camera.cy)).astype(np.int32)
    # depth in steps of 10 um and index in one number, because the minimum must say which point it was
    key = (np.rint(z * np.float32(1e5)).astype(np.int64) << 32) | np.arange(len(points))
    nearest = np.full(camera.height * camera.width, _NOTHING)
    for dv, du in _SPLAT:
        u, v = left + du, top + dv
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        np.minimum.at(nearest, (v * camera.width + u)[inside], key[inside])
    is_seen = nearest != _NOTHING
    index = np.where(is_seen, nearest & 0xFFFFFFFF, -1).astype(np.int32)
    depth_m = np.full(len(index), np.nan, dtype=np.float32)
    depth_m[is_seen] = z[index[is_seen]]
    return depth_m.reshape(camera.height, camera.width), index.reshape(camera.height, camera.width)
