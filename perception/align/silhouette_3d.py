"""Our alignment: silhouettes give the in-plane turn, the clouds give the rest. In the ``color`` frame.

A turn about the optical axis keeps the seen side visible; principal axes ignore this. Objects with nearly equal
principal axes still have an outline. Each silhouette fit, and the unchanged pose, starts a trimmed, scaled, two-way
3-D refinement; the smallest residual wins. Among equals (symmetric objects) the smaller turn wins.
"""

from __future__ import annotations

import numpy as np

from perception.align.base import Array, Fit, Shape
from perception.align.refine import Clouds, Pose
from perception.align.silhouette import outline, silhouette_fits
from perception.geometry.lift import subsample

_STARTS = 4
_FIRST, _THEN = 4, 8
_SURVIVORS = 2
_VOXEL = 0.13
_COARSE, _FINE = 200, 500
"""Most points of a cloud in the coarse and in the fine refinement."""
_TURN_WEIGHT = 0.004


def silhouette_3d(goal: Shape, observed: Shape) -> Fit:
    """Align from the silhouettes' in-plane starts, refined in 3-D with one scale and a relief gain of the depth."""
    goal_center, observed_center = goal.points.mean(axis=0), observed.points.mean(axis=0)
    goal_cloud, observed_cloud = goal.points - goal_center, observed.points - observed_center
    goal_even, observed_even = _even(goal_cloud), _even(observed_cloud)
    coarse, fine = (Clouds(subsample(goal_even, most), subsample(observed_even, most)) for most in (_COARSE, _FINE))
    # Lateral spread only: the imagined relief is unreliable.
    scale = float(
        np.sqrt((observed_cloud[:, :2] ** 2).sum(axis=1).mean() / (goal_cloud[:, :2] ** 2).sum(axis=1).mean())
    )
    angles = [0.0, *(fit.angle_rad for fit in silhouette_fits(outline(goal), outline(observed), _STARTS))]
    starts = [Pose(_about_optical_axis(angle), scale, np.zeros(3)) for angle in angles]
    near = [coarse.refine(start, _FIRST, relief=True, rescale=True) for start in starts]
    unit_m = float(np.sqrt((observed_cloud**2).sum(axis=1).mean()))

    def loss(pose: Pose) -> float:
        turn = np.arccos(np.clip((np.trace(pose.rotation) - 1) / 2, -1, 1))
        return fine.loss_m(pose) / unit_m + _TURN_WEIGHT * float(turn) / np.pi

    best = sorted(near, key=loss)[:_SURVIVORS]
    pose = min((fine.refine(one, _THEN, relief=True, rescale=True, begin=_FIRST) for one in best), key=loss)
    return Fit(pose.between(goal_center, observed_center), pose.scale, len(starts))


def _about_optical_axis(angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _even(cloud: Array) -> Array:
    """The mean of every voxel (0.13 rms radii wide), so that the points (n, 3) have equal density."""
    size_m = _VOXEL * float(np.sqrt((cloud**2).sum(axis=1).mean()))
    cells = np.floor(cloud / size_m).astype(np.int64)
    cells -= cells.min(axis=0)
    flat = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, index, counts = np.unique(flat, return_inverse=True, return_counts=True)
    return np.stack([np.bincount(index, weights=cloud[:, k]) / counts for k in range(3)], axis=1)
