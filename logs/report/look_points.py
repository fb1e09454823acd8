"""The measured points of the things in each look, in ``base``, and what each look added to the ones before it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from bus.arrays import LabelImage, Mask, Transform
from bus.messages import CameraModel, Frame, Observation, ObservedScene
from bus.transforms import apply, inverse

_CELL_M = 0.004
_NEW_M = 0.006
"""A place this far from all that earlier looks measured is new: nearer ones differ by the camera's noise."""
_BESIDE_M, _ALONE = 0.010, 3
_TABLE_NOISE_M = 0.004
_STEP_M = 0.010

Points = npt.NDArray[np.float64]


def true_pose(seen: Observation, scene: ObservedScene | None) -> Transform:
    """Return the pose (4, 4) of the colour camera that detect believed, with the correction of the mounting, if any."""
    if scene is not None and scene.mount is not None:
        seen = seen.corrected(scene.mount.color_from_corrected)
    return seen.view.base_from_color


def points_of_things(scene: ObservedScene, looks: Sequence[Observation]) -> list[Points]:
    """Of each look the points (n, 3) [m] of the things, one in each cube of 4 mm; none where labels are missing."""
    labels = scene.look_labels
    found = []
    for index, seen in enumerate(looks):
        ours = labels[index] if index < len(labels) else None
        if ours is None or ours.shape != seen.frame.color.shape[:2]:
            found.append(np.zeros((0, 3)))
            continue
        points = apply(true_pose(seen, scene), _labelled(seen.frame, ours))
        height_m = apply(inverse(scene.table.base_from_table), points)[:, 2]
        found.append(_thin(points[height_m > _TABLE_NOISE_M]))  # behind a thing's rim lies the table
    return found


def added_shares(clouds: Sequence[Points]) -> list[float]:
    """Return the share of all measured points that each look measured first; 0 for each when there is nothing."""
    before = np.zeros((0, 3))
    new = []
    for points in clouds:
        is_new = np.ones(len(points), dtype=bool)
        if len(before) and len(points):
            is_new = cKDTree(before).query(points, distance_upper_bound=_NEW_M)[0] > _NEW_M
        new.append(int(is_new.sum()))
        before = np.concatenate([before, points[is_new]])
    return [count / max(sum(new), 1) for count in new]


def _thin(points: Points) -> Points:
    """One of the points in each cell, without those that stand alone."""
    _, first = np.unique(np.floor(points / _CELL_M).astype(np.int64), axis=0, return_index=True)
    points = points[np.sort(first)]
    if not len(points):
        return points
    beside = cKDTree(points).query_ball_point(points, _BESIDE_M, return_length=True)
    return np.asarray(points[beside > _ALONE])


def _labelled(frame: Frame, labels: LabelImage) -> Points:
    """The measured points (n, 3) in ``color`` that project into a thing of the undistorted colour image."""
    measured = _in_front(frame.depth_m)
    rays = _rays(frame.depth_camera)[measured]
    points = apply(np.asarray(frame.color_from_depth), rays * frame.depth_m[measured, None])
    camera = frame.color_camera
    points = points[points[:, 2] > 0]
    u = np.rint(points[:, 0] / points[:, 2] * camera.fx + camera.cx).astype(int)
    v = np.rint(points[:, 1] / points[:, 2] * camera.fy + camera.cy).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    return np.asarray(points[inside][labels[v[inside], u[inside]] > 0])


def _in_front(depth_m: npt.NDArray[np.float32]) -> Mask:
    """The pixels (h, w) with depth and nothing nearer beside them: without those that smear from a rim to behind it."""
    depth_m = np.where(np.isfinite(depth_m), depth_m, np.float32(np.inf))
    nearest_m = cv2.erode(depth_m, np.ones((3, 3), np.uint8))
    return np.asarray(np.isfinite(depth_m) & (depth_m < nearest_m + _STEP_M))


@lru_cache(maxsize=2)
def _rays(camera: CameraModel) -> Points:
    """Rays (h, w, 3) with z = 1 of all pixels, without distortion."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    xy = cv2.undistortPoints(pixels, matrix, np.array(camera.distortion or [0.0] * 5))[:, 0]
    return np.column_stack([xy, np.ones(len(xy))]).reshape(camera.height, camera.width, 3)
