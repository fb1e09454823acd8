"""What planning needs to see: the depth image as points in ``base``, and which of them are the target."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.arrays import Mask, Points
from bus.messages import Observation
from perception.depth import rays, without_flying_pixels
from perception.lift import project, transform

_STEP_PX = 2
"""Every second pixel: about 3 mm apart where the hand works."""
_EDGE_PX = 2
"""So far from a surface missing depth is taken for its rim; as far as planning spares around the target."""


def surroundings(observation: Observation, object_mask: Mask) -> tuple[Points, npt.NDArray[np.bool_]]:
    """The depth camera's own image, thinned, so that neighbours are neighbours in its sight.

    Args:
        object_mask: (H, W) of the target in the undistorted colour image.

    Returns:
        Points (h, w, 3) [m] in ``base``, NaN = no depth, and which of them (h, w) are the target.
    """
    frame = observation.frame
    depth_m = _edges_filled(without_flying_pixels(frame.depth_m)[::_STEP_PX, ::_STEP_PX])
    points = rays(frame.depth_camera)[::_STEP_PX, ::_STEP_PX] * depth_m[..., None].astype(float)
    in_color = transform(frame.color_from_depth, points.reshape(-1, 3))
    is_target = np.zeros(len(in_color), dtype=bool)
    seen = np.flatnonzero(np.isfinite(in_color[:, 2]) & (in_color[:, 2] > 0))
    u, v = np.rint(project(in_color[seen], frame.color_camera)).astype(int).T
    inside = (u >= 0) & (u < object_mask.shape[1]) & (v >= 0) & (v < object_mask.shape[0])
    is_target[seen[inside]] = object_mask[v[inside], u[inside]]
    in_base = transform(observation.view.base_from_color, in_color)
    return in_base.astype(np.float32).reshape(points.shape), is_target.reshape(depth_m.shape)


def _edges_filled(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Depth with the holes at its edges filled from the nearer surface: depth cameras lose an object's rim."""
    nothing = np.isnan(depth_m)
    nearest = ndimage.minimum_filter(np.where(nothing, np.inf, depth_m), size=2 * _EDGE_PX + 1)
    return np.where(nothing & np.isfinite(nearest), nearest, depth_m).astype(np.float32)
