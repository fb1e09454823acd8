"""The surface in a depth image: points without most of the noise, and normals that look at the camera. In ``base``."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Mask
from perception.scene.depth_view import DepthView

_SMOOTHED_PX, _SIGMA_PX = 5, 1.5
"""Window of the smoothing: a missing pixel in it leaves none, so that no surface is mixed with another."""
_APART_PX = 2
"""Normals are taken over so many pixels to each side."""
_STEP_M = 0.005
"""A depth that differs by so much from that of its window, or from the mean of those to both sides, lies at a step."""

_CONTINUED_PX = (2, 4)
_ON_FACE_M = 0.002
"""A point without a normal lies on a face seen so many pixels away when it is so near its plane."""

Points = npt.NDArray[np.float32]
Depth = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Surface:
    """The smooth surfaces that a depth image shows.

    Attributes:
        points_base: (h, w, 3) [m], smoothed along the rays; NaN at steps, and where depth is missing within two pixels.
        normals_base: (h, w, 3) unit normals towards the camera; NaN also beside steps.
    """

    points_base: Points
    normals_base: Points


def surface(view: DepthView) -> Surface:
    """Smooth a view, and take normals from differences of its points."""
    smooth_m = cv2.GaussianBlur(view.depth_m, (_SMOOTHED_PX, _SMOOTHED_PX), _SIGMA_PX)
    smooth_m[np.abs(smooth_m - view.depth_m) > _STEP_M] = np.nan  # a mixture of what is before and behind
    camera = view.base_from_depth[:3, 3].astype(np.float32)
    from_camera = (view.points_base - camera) * (smooth_m / view.depth_m)[..., None]
    return Surface(from_camera + camera, _normals(from_camera, smooth_m))


def continued(view: DepthView, surface: Surface, mask: Mask) -> Points:
    """Normals (h, w, 3) with those of a face's rim, where a difference would reach beyond it.

    A pixel of ``mask`` (h, w) without a normal gets that of the neighbour whose plane passes nearest to its point.
    """
    points, planes = view.points_base.reshape(-1, 3), surface.points_base.reshape(-1, 3)
    known = surface.normals_base.reshape(-1, 3)
    at = np.flatnonzero(mask.ravel() & np.isnan(known[:, 0]))
    (height, width), (v, u) = mask.shape, np.divmod(at, mask.shape[1])
    normals, nearest_m = known.copy(), np.full(len(at), _ON_FACE_M, dtype=np.float32)
    for dv, du in ((step * dv, step * du) for step in _CONTINUED_PX for dv in (-1, 0, 1) for du in (-1, 0, 1)):
        beside = np.clip(v + dv, 0, height - 1) * width + np.clip(u + du, 0, width - 1)
        off_m = np.abs(np.einsum("ij,ij->i", points[at] - planes[beside], known[beside]))
        is_nearer = off_m < nearest_m  # NaN compares false
        nearest_m[is_nearer] = off_m[is_nearer]
        normals[at[is_nearer]] = known[beside[is_nearer]]
    return normals.reshape(view.points_base.shape)


def _normals(from_camera: Points, smooth_m: Depth) -> Points:
    """Unit normals (h, w, 3) of points (h, w, 3) seen from their frame's origin, of which ``smooth_m`` is the depth."""
    far = 2 * _APART_PX
    normals = np.full_like(from_camera, np.nan)
    ax, ay, az = cv2.split(from_camera[_APART_PX:-_APART_PX, far:] - from_camera[_APART_PX:-_APART_PX, :-far])
    bx, by, bz = cv2.split(from_camera[far:, _APART_PX:-_APART_PX] - from_camera[:-far, _APART_PX:-_APART_PX])
    cross = cv2.merge([by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax])
    x, y, z = cv2.split(cross)
    scale = 1 / np.sqrt(x * x + y * y + z * z)
    scale[_at_step(smooth_m)] = np.nan
    normals[_APART_PX:-_APART_PX, _APART_PX:-_APART_PX] = cross * scale[..., None]
    return normals


def _at_step(smooth_m: Depth) -> npt.NDArray[np.bool_]:
    """Inner pixels whose depth is not near the mean of those on both sides, along rows or columns."""
    far = 2 * _APART_PX
    inner = smooth_m[_APART_PX:-_APART_PX, _APART_PX:-_APART_PX]
    across = smooth_m[_APART_PX:-_APART_PX, far:] + smooth_m[_APART_PX:-_APART_PX, :-far]
    along = smooth_m[far:, _APART_PX:-_APART_PX] + smooth_m[:-far, _APART_PX:-_APART_PX]
    return np.asarray(np.maximum(np.abs(across - 2 * inner), np.abs(along - 2 * inner)) > 2 * _STEP_M)
