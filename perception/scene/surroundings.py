"""The observed points that planning needs: the depth image in ``base``, and a mask of the target's points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.arrays import Mask, Points
from bus.messages import CameraModel, Observation
from bus.transforms import apply
from perception.geometry.depth import rays, without_flying_pixels
from perception.geometry.lift import project

Depths = npt.NDArray[np.float32]

_STEP_PX = 2
"""Every second pixel: about 3 mm apart at working distance."""
_BLOCK_PX, _BEHIND_M = 8, 0.10
"""So far behind the nearest point in its block of the colour image, a point is hidden from the colour camera."""
_EDGE_PX = 2
"""Missing depth within this distance of a surface counts as its rim; equals the margin that planning spares around the
target."""


def surroundings(observation: Observation, object_mask: Mask) -> tuple[Points, npt.NDArray[np.bool_]]:
    """Return the depth camera's own image, subsampled; image neighbours stay neighbours, as the camera sees them.

    Args:
        object_mask: (H, W) of the target in the undistorted colour image.

    Returns:
        Points (h, w, 3) [m] in ``base``, NaN = no depth, and the mask (h, w) of the target's points.
    """
    frame = observation.frame
    seen_m = without_flying_pixels(frame.depth_m)[::_STEP_PX, ::_STEP_PX]
    depth_m = _edges_filled(seen_m)
    points = rays(frame.depth_camera)[::_STEP_PX, ::_STEP_PX] * depth_m[..., None].astype(float)
    in_color = apply(frame.color_from_depth, points.reshape(-1, 3))
    on_mask, in_front = _is_on(object_mask, in_color, frame.color_camera)
    is_target = (on_mask & in_front).reshape(depth_m.shape)
    in_base = apply(observation.view.base_from_color, in_color).astype(np.float32).reshape(points.shape)
    in_base[(on_mask & ~in_front).reshape(depth_m.shape)] = np.nan
    in_base[_filled_from(is_target, seen_m, depth_m) & ~is_target] = np.nan
    return in_base, is_target


def _is_on(
    mask: Mask, in_color: npt.NDArray[np.float64], camera: CameraModel
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """The points (n, 3) in the colour camera, NaN = none, that project into ``mask``; and which are not hidden there.

    The depth camera sits beside the colour camera: past an edge it sees what lies behind the object.
    """
    is_on = np.zeros(len(in_color), dtype=bool)
    seen = np.flatnonzero(np.isfinite(in_color[:, 2]) & (in_color[:, 2] > 0))
    u, v = np.rint(project(in_color[seen], camera)).astype(int).T
    inside = (u >= 0) & (u < mask.shape[1]) & (v >= 0) & (v < mask.shape[0])
    seen, u, v = seen[inside], u[inside], v[inside]
    is_on[seen] = mask[v, u]
    nearest_m = np.full((mask.shape[0] // _BLOCK_PX + 1, mask.shape[1] // _BLOCK_PX + 1), np.inf)
    np.minimum.at(nearest_m, (v // _BLOCK_PX, u // _BLOCK_PX), in_color[seen, 2])
    in_front = np.ones(len(in_color), dtype=bool)
    in_front[seen] = in_color[seen, 2] < nearest_m[v // _BLOCK_PX, u // _BLOCK_PX] + _BEHIND_M
    return is_on, in_front


def _edges_filled(depth_m: Depths) -> Depths:
    """Depth with the holes at its edges filled from the nearer surface: depth cameras lose an object's rim."""
    nothing = np.isnan(depth_m)
    nearest = _nearest(depth_m, ~nothing)
    return np.where(nothing & np.isfinite(nearest), nearest, depth_m).astype(np.float32)


def _filled_from(which: Mask, seen_m: Depths, filled_m: Depths) -> Mask:
    """Pixels that ``filled_m`` continues from ``which``: beyond the target's outline they are no obstacle."""
    was_filled = np.isnan(seen_m) & np.isfinite(filled_m)
    return np.asarray(was_filled & (filled_m == _nearest(seen_m, which & ~np.isnan(seen_m))))


def _nearest(depth_m: Depths, which: Mask) -> Depths:
    """The least depth [m] of the pixels ``which`` around each pixel; inf where there is none."""
    return np.asarray(ndimage.minimum_filter(np.where(which, depth_m, np.inf), size=2 * _EDGE_PX + 1), np.float32)
