"""Paints a rod into an observed image: a shaded cylinder, hidden where the object is nearer. In the ``color`` frame."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from perception.geometry.lift import project
from perception.observed_object import GoalImage, ObservedObject, PaintedRod

_HIDING_M = 0.003
"""Tolerance: a surface hides the rod also when measured this far behind it, because depth is noisy."""
_LIGHT = np.array([-0.35, -0.45, -0.82])  # towards the light, camera frame

Array = npt.NDArray[np.float64]


def paint(
    observed_object: ObservedObject,
    ends: Array,
    radius_m: float,
    run: Array | None = None,
    approach_base: Array | None = None,
) -> GoalImage:
    """Return the masked image with a rod, z-buffered with the object.

    Args:
        ends: (2, 3) [m] of the rod, in the camera frame.
        run: (2, 3) [m] its run through the object, if it is known. ``approach_base``: see `PaintedRod`.

    Returns:
        The picture, and its parts, which are known because they were painted here.

    Raises: ValueError for ends that are no line in front of the camera.
    """
    if np.shape(ends) != (2, 3) or not np.isfinite(ends).all() or not (ends[:, 2] > 0).all():
        raise ValueError(
            f"ends = {np.asarray(ends).tolist()} m: they are (2, 3) finite numbers, z in front of the camera"
        )
    observed_m = _filled(observed_object)
    depth_m, normals = _cylinder(ends, radius_m, observed_object)
    visible = np.isfinite(depth_m) & ~(observed_m < depth_m + _HIDING_M)
    light = np.abs(normals[visible] @ (_LIGHT / np.linalg.norm(_LIGHT)))
    shade = np.clip(0.35 + 0.65 * light, 0, 1) + 0.25 * light**12
    image = observed_object.masked.copy()
    image[visible] = np.clip(np.array(observed_object.rod.rgb) * shade[:, None], 0, 255).astype(np.uint8)
    goal_depth_m = np.where(visible, depth_m, observed_object.rgbd.depth_m).astype(np.float32)
    return GoalImage(image, goal_depth_m, PaintedRod(visible, observed_object.mask & ~visible, run, approach_base))


def _filled(observed_object: ObservedObject) -> npt.NDArray[np.float32]:
    """Observed depth (H, W) of the object with pinholes filled from the nearest surface beside them; NaN elsewhere."""
    observed = np.where(observed_object.mask, observed_object.rgbd.depth_m, np.inf).astype(np.float32)
    closed = cv2.erode(cv2.dilate(-observed, np.ones((5, 5))), np.ones((5, 5)))
    return np.where(np.isinf(closed), np.nan, -closed).astype(np.float32)


def _cylinder(ends: Array, radius_m: float, observed_object: ObservedObject) -> tuple[Array, Array]:
    """Z-depth (H, W) of the cylinder's near surface in the camera, NaN beside it; and its normals (H, W, 3)."""
    camera = observed_object.rgbd.camera
    along = ends[1] - ends[0]
    length_m = float(np.linalg.norm(along))
    along = along / length_m
    depth_m = np.full((camera.height, camera.width), np.nan)
    normals = np.zeros((camera.height, camera.width, 3))
    box = project(ends, camera)
    pad = 2 * radius_m / float(ends[:, 2].min()) * camera.fx + 2
    u0, v0 = np.maximum(np.floor(box.min(axis=0) - pad), 0).astype(int)
    u1, v1 = np.minimum(np.ceil(box.max(axis=0) + pad), [camera.width - 1, camera.height - 1]).astype(int)
    if u1 < u0 or v1 < v0:  # beside the picture
        return depth_m, normals
    u, v = np.meshgrid(np.arange(u0, u1 + 1), np.arange(v0, v1 + 1))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    # |(ray z - end) - along ((ray z - end) . along)| = radius, for the smaller z
    across = rays - (rays @ along)[..., None] * along
    offset = ends[0] - along * (ends[0] @ along)
    a, b, c = (across**2).sum(-1), across @ offset, offset @ offset - radius_m**2
    root = b**2 - a * c
    z = (b - np.sqrt(np.maximum(root, 0))) / a
    points = rays * z[..., None]
    position = (points - ends[0]) @ along
    hit = (root > 0) & (position >= 0) & (position <= length_m)
    depth_m[v0 : v1 + 1, u0 : u1 + 1] = np.where(hit, z, np.nan)
    normals[v0 : v1 + 1, u0 : u1 + 1] = (points - ends[0] - position[..., None] * along) / radius_m
    return depth_m, normals
