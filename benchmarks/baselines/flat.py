"""A scene from an image without usable depth: its things are prisms of their own outline, seen from straight above.

Results are valid in the image; lengths along the line of sight are invented, so it never moves an arm.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import CameraModel, Frame, Instance, Observation, Rectangle, View
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.crop import Mask
from perception.geometry.rod import rectangle
from perception.goal.axes import axes_of
from perception.goal.imagine import observed_object_of
from perception.goal.target import by_best_grasp
from perception.grasps.rank import graded
from perception.grasps.search import search
from perception.observed_object import ObservedObject
from perception.scene.scene import Scene, observe
from perception.scene.seen import RegionView, described

_FOCAL_PX = 1000.0
_HEIGHT_M = 0.04


def flat_object(color: npt.NDArray[np.uint8], object_mask: Mask, m_per_px: float, station: Station) -> ObservedObject:
    """The thing with the best grasp; ``m_per_px`` is the scale on its upper side. Raises: CycleFailure(NO_OBJECT)."""
    scene, instances = flat_scene(color, object_mask, m_per_px, station)
    closings = graded(search(scene.heights, _without_fixtures(station)), instances)
    number = by_best_grasp(scene, closings)[0]
    axes = axes_of(closings, number, scene.table.base_from_table)
    outline, margin_px = scene.color_labels == number, max(object_mask.shape)  # so the crop is the whole image
    return observed_object_of(scene, instances, number, outline, axes, margin_px)[0]


def flat_scene(
    color: npt.NDArray[np.uint8], object_mask: Mask, m_per_px: float, station: Station
) -> tuple[Scene, tuple[Instance, ...]]:
    """The scene and the things in it, what is masked 40 mm high. Raises: CycleFailure(NO_OBJECT)."""
    anywhere = _without_fixtures(station)
    scene = observe(_observation(color, object_mask, m_per_px), anywhere)
    if not scene.count:
        raise CycleFailure(Code.NO_OBJECT, "Nothing stands out from the surface.")
    return scene, described(scene, RegionView.of(scene, anywhere)).instances


def _without_fixtures(station: Station) -> Station:
    """The station with nothing on its table, and all of it searched."""
    scene = station.scene
    tray = scene.tray.model_copy(update={"center_m": (5.0, 5.0, 0.0)})
    bare = {"pick_region_m": (-2.0, 2.0, -2.0, 2.0), "tray": tray, "obstacles": (), "bins": ()}
    return station.model_copy(update={"scene": scene.model_copy(update=bare)})


def _observation(color: npt.NDArray[np.uint8], object_mask: Mask, m_per_px: float) -> Observation:
    """The image over a table from straight above, what is masked 40 mm high."""
    height, width = object_mask.shape
    center = {"cx": (width - 1) / 2, "cy": (height - 1) / 2}
    camera = CameraModel(width=width, height=height, fx=_FOCAL_PX, fy=_FOCAL_PX, **center)
    top_m = _FOCAL_PX * m_per_px
    base_from_color = np.diag([1.0, -1.0, -1.0, 1.0])
    base_from_color[2, 3] = top_m + _HEIGHT_M
    frame = Frame(
        stamp_ns=1,
        color=color,
        depth_m=np.where(object_mask, top_m, top_m + _HEIGHT_M).astype(np.float32),
        color_camera=camera,
        depth_camera=camera,
        color_from_depth=np.eye(4),
    )
    return Observation(view=View(stamp_ns=1, base_from_color=base_from_color), frame=frame)


def flat_rectangle(observed_object: ObservedObject, station: Station) -> Rectangle:
    """The search alone: its best closing as a rectangle. Raises: CycleFailure(NO_GRASP)."""
    if not observed_object.axes:
        raise CycleFailure(Code.NO_GRASP, "No two opposite faces fit the jaw.")
    ends = apply(inverse(observed_object.base_from_color), observed_object.axes[0].ends_base)
    return rectangle(ends, observed_object.rgbd.camera, station)
