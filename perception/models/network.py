"""A grasp network in the role of the goal-image model: it gives the axis; the embedded model's painter adds the rod."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.transforms import apply
from config.schema import Station
from perception.geometry.lift import lift_pixels
from perception.models.geometric import GeometricModel, axis_in_words
from perception.observed_object import Answer, ObservedObject
from perception.rectangles.network import GraspNetwork


class NetworkModel(GeometricModel):
    """The embedded model, except that the axis is the network's best rectangle, at the level of the object's middle.

    Raises: ConfigError, as `GraspNetwork`.
    """

    name = "onnx"
    _knows_run = False

    def __init__(self, station: Station) -> None:
        super().__init__(station)
        self._network = GraspNetwork(Path(station.perception.onnx.path))

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Return the network's rectangle, as an axis in ``base``, as text."""
        rgbd, outline = observed_object.scene.rgbd, observed_object.scene.outline(observed_object.instance.number)
        found = self._network.detect(rgbd.color, rgbd.depth_m, outline)
        direction = np.array([np.cos(found.angle_rad), np.sin(found.angle_rad)])
        half_px = found.width_px / 2 * direction
        ends_px = np.array(found.center_px) + np.stack([-half_px, half_px])
        ends = apply(observed_object.base_from_color, self._lifted(ends_px, observed_object))
        return Answer(
            f"The network's best rectangle is at ({found.center_px[0]:.0f}, {found.center_px[1]:.0f}) px, "
            f"{found.width_px:.0f} px wide. " + axis_in_words(ends[0], ends[1])
        )

    def _lifted(self, ends_px: npt.NDArray[np.float64], observed_object: ObservedObject) -> npt.NDArray[np.float64]:
        """(2, 3) [m] in the camera frame: at the middle level of the object's seen surface, less the rod's radius."""
        depth_m = float(np.nanmedian(observed_object.level_depth_m[observed_object.mask]))
        radius_m = self._station.perception.rod_radius_m
        return lift_pixels(ends_px, np.full(2, depth_m + 2 * radius_m), observed_object.scene.rgbd.camera)
