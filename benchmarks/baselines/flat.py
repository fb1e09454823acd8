"""A scene from an image without usable depth: the object is a prism of its own outline, seen from straight above.

Results are valid in the image; lengths along the line of sight are invented, so it never moves an arm.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import CameraModel, Rectangle
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.depth import Rgbd
from perception.geometry.rod import rectangle
from perception.goal.imagine import observed_object_of
from perception.grasps import antipodal
from perception.observed_object import ObservedObject
from perception.scene.segment import Mask, Scene, image_points

_FOCAL_PX = 1000.0
_HEIGHT_M = 0.04


def flat_object(color: npt.NDArray[np.uint8], object_mask: Mask, m_per_px: float) -> ObservedObject:
    """The subject of an imagining, at the scale of ``m_per_px`` on the object's upper side."""
    height, width = object_mask.shape
    camera = CameraModel(
        width=width, height=height, fx=_FOCAL_PX, fy=_FOCAL_PX, cx=(width - 1) / 2, cy=(height - 1) / 2
    )
    top_m = _FOCAL_PX * m_per_px
    base_from_color = np.diag([1.0, -1.0, -1.0, 1.0])
    base_from_color[2, 3] = top_m + _HEIGHT_M
    depth_m = np.where(object_mask, top_m, top_m + _HEIGHT_M).astype(np.float32)
    rgbd = Rgbd(color, depth_m, camera)
    points_base = image_points(rgbd, base_from_color)
    return observed_object_of(rgbd, Scene(points_base, points_base[..., 2], object_mask), base_from_color)


def flat_rectangle(observed_object: ObservedObject, station: Station) -> Rectangle:
    """The antipodal search alone: its best closing as a rectangle. Raises: CycleFailure(NO_GRASP)."""
    closings = antipodal.propose(observed_object.heights, station)
    best = closings.distinct(1)
    if not best:
        raise CycleFailure(Code.NO_GRASP, "No two opposite faces fit the jaw.")
    heading, width_m = closings.heading_rad[best[0]], closings.width_m[best[0]]
    half = width_m / 2 * np.array([np.cos(heading), np.sin(heading), 0.0])
    center = np.append(closings.center_m[best[0]], _HEIGHT_M)
    ends = apply(inverse(observed_object.base_from_color), np.stack([center - half, center + half]))
    return rectangle(ends, observed_object.rgbd.camera, station)
