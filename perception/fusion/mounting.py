"""One error of the camera's mounting, from the disagreement of several views: the same in each in the frame ``color``.

Gauss-Newton on the distances of each view's points from the surfaces that each other view shows where they appear in
it. What no view disagrees about stays as the station has it: the result is never far from there, and bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bus.arrays import Mask, Transform
from bus.transforms import apply, from_rotation, from_rotvec, inverse, to_rotvec
from perception.geometry.depth import moved
from perception.scene.depth_view import DepthView
from perception.scene.normals import Surface

PRIOR_RAD, PRIOR_M = float(np.deg2rad(0.5)), 0.003
"""Standard deviation, about and along each axis, of a mounting that was calibrated."""
_BOUND = 3.0
"""A longer turn or shift, in standard deviations, is cut to this."""
_POINTS = 4000
"""So many points of each view are compared."""
_RADII_M = (0.012, 0.008, 0.006, 0.005, 0.004)
"""Points farther apart are not the same place; smaller from step to step."""
_LEAST_COSINE = float(np.cos(np.deg2rad(37.0)))
_NOISE_M = 0.0015
"""Noise of a distance; those much longer hardly count (Geman-McClure)."""
_INDEPENDENT = 40
"""A pair of views says as much as so many points would: the sensor's errors are alike in neighbouring pixels."""
_FEWEST = 100
"""Fewer common points of two views say nothing."""

Array = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MountCorrection:
    """The correction of a mounting: ``base_from_color @ color_from_corrected`` is the better pose of every view.

    Attributes:
        color_from_corrected: (4, 4).
        covariance: (6, 6) of its rotation vector [rad] and translation [m], that of a calibrated mounting included.
        residual_before_m, residual_after_m: median distance between the views' surfaces; NaN without a pair.
        pairs: ordered pairs of views that see enough in common.
        is_cut: whether the views ask for more than is believed of a calibrated mounting.
    """

    color_from_corrected: Transform
    covariance: Array
    residual_before_m: float
    residual_after_m: float
    pairs: int
    is_cut: bool

    def base_from_believed(self, base_from_color: Transform) -> Transform:
        """Return the motion (4, 4) in ``base`` that corrects what was seen from ``base_from_color`` (4, 4)."""
        return np.asarray(base_from_color @ self.color_from_corrected @ inverse(base_from_color))

    def view(self, view: DepthView, base_from_color: Transform) -> DepthView:
        """Return the view from where it was truly taken."""
        motion = self.base_from_believed(base_from_color)
        points_base = moved(view.points_base, motion)
        return replace(view, base_from_depth=motion @ view.base_from_depth, points_base=points_base)

    def surface(self, surface: Surface, base_from_color: Transform) -> Surface:
        """Return the surface where it truly is."""
        motion = self.base_from_believed(base_from_color)
        normals_base = moved(surface.normals_base, from_rotation(motion[:3, :3]))
        return Surface(moved(surface.points_base, motion), normals_base)


@dataclass(frozen=True, eq=False)
class _Look:
    """One view in ``color``: its surface (h, w, 3), and the points (n, 3) and normals that others are asked about."""

    view: DepthView
    base_from_color: Transform
    points: Points
    normals: Points
    asked: Array
    asked_normals: Array

    @classmethod
    def of(cls, view: DepthView, surface: Surface, base_from_color: Transform, mask: Mask | None) -> _Look:
        color_from_base = inverse(base_from_color)
        points = moved(surface.points_base, color_from_base)
        normals = moved(surface.normals_base, from_rotation(color_from_base[:3, :3]))
        has_normal = np.isfinite(surface.normals_base[..., 0])
        at = np.flatnonzero(has_normal if mask is None else has_normal & mask)
        at = at[:: max(1, len(at) // _POINTS)]
        asked, asked_normals = (image.reshape(-1, 3)[at].astype(float) for image in (points, normals))
        return cls(view, base_from_color, points, normals, asked, asked_normals)


def common_correction(
    views: Sequence[DepthView],
    surfaces: Sequence[Surface],
    base_from_color: Sequence[Transform],
    masks: Sequence[Mask] | None = None,
) -> MountCorrection:
    """Find the mounting with which the views agree best; without common surfaces it is the station's.

    Args:
        surfaces: `perception.scene.normals.surface` of each view. ``base_from_color``: (4, 4) of each, as believed.
        masks: (h, w) of each, the depth pixels whose points are compared; None = all.
    """
    each = masks if masks is not None else [None] * len(views)
    looks = [_Look.of(*one) for one in zip(views, surfaces, base_from_color, each, strict=True)]
    correction = np.eye(4)
    information = np.diag(np.repeat([PRIOR_RAD**-2, PRIOR_M**-2], 3))
    covariance = np.linalg.inv(information)
    before_m, pairs = _disagreement(looks, correction)
    for radius_m in _RADII_M if pairs else ():
        hessian, gradient = information.copy(), information @ to_rotvec(correction)
        for residuals_m, jacobian in _compared(looks, correction, radius_m):
            share = _INDEPENDENT / len(residuals_m) / _NOISE_M**2
            weighted = (jacobian * (share * _weights(residuals_m))[:, None]).T
            hessian += weighted @ jacobian
            gradient += weighted @ residuals_m
        covariance = np.linalg.inv(hessian)
        correction = correction @ from_rotvec(-covariance @ gradient)
    believed = bounded(to_rotvec(correction))
    is_cut = not np.allclose(believed, to_rotvec(correction), rtol=0, atol=1e-9)
    correction = from_rotvec(believed)
    after_m, _ = _disagreement(looks, correction)
    return MountCorrection(correction, covariance, before_m, after_m, pairs, is_cut)


def _disagreement(looks: Sequence[_Look], correction: Transform) -> tuple[float, int]:
    """Median distance [m] between the views' surfaces, and how many pairs of views have some in common."""
    every = [np.abs(residuals_m) for residuals_m, _ in _compared(looks, correction, _RADII_M[0])]
    return (float(np.median(np.concatenate(every))) if every else float("nan")), len(every)


def _compared(looks: Sequence[_Look], correction: Transform, radius_m: float) -> list[tuple[Array, Array]]:
    """Distances (k,) [m] and their derivatives (k, 6) of every ordered pair of views with enough in common."""
    compared = [_distances(one, other, correction, radius_m) for one in looks for other in looks if one is not other]
    return [(residuals_m, jacobian) for residuals_m, jacobian in compared if len(residuals_m) >= _FEWEST]


def _distances(source: _Look, target: _Look, correction: Transform, radius_m: float) -> tuple[Array, Array]:
    """Signed distances (k,) [m] of the source's points from the target's surface, and derivatives (k, 6).

    A point is compared with what the target shows in the pixel where the point appears. The derivative is by a turn
    [rad] and shift [m] that follow the correction, in both views at once.
    """
    target_from_source = inverse(target.base_from_color @ correction) @ source.base_from_color @ correction
    turn = target_from_source[:3, :3]
    points = apply(target_from_source, source.asked)
    u, v, inside = _seen_at(target, points)
    shown, normals = (image[v, u].astype(float) for image in (target.points, target.normals))
    apart = points - shown
    faces = np.einsum("ij,ij->i", source.asked_normals @ turn.T, normals) > _LEAST_COSINE  # NaN compares false
    same = inside & faces & (np.einsum("ij,ij->i", apart, apart) < radius_m**2)
    asked, points, normals, apart = source.asked[same], points[same], normals[same], apart[same]
    in_source = normals @ turn
    jacobian = np.hstack([np.cross(asked, in_source) - np.cross(points, normals), in_source - normals])
    return np.einsum("ij,ij->i", apart, normals), jacobian


def _seen_at(target: _Look, points: Array) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], Mask]:
    """The depth pixels u, v (n,) in which points (n, 3) of the target's ``color`` appear, 0 where they do not."""
    pixels, z = target.view.pixels(apply(target.base_from_color, points).astype(np.float32))
    inside = target.view.inside(pixels, z)
    u, v = np.where(inside[:, None], pixels, 0).T
    return u, v, inside


def _weights(residuals_m: Array) -> Array:
    """Geman-McClure."""
    return np.asarray((_NOISE_M**2 / (_NOISE_M**2 + residuals_m**2)) ** 2)


def bounded(vector: Array) -> Array:
    """Return the rotation vector and translation (6,), neither longer than believed."""
    longest = _BOUND * np.array([PRIOR_RAD, PRIOR_M])
    length = np.array([np.linalg.norm(vector[:3]), np.linalg.norm(vector[3:])])
    return np.asarray(vector * np.repeat(np.minimum(1.0, longest / np.maximum(length, 1e-12)), 3))
