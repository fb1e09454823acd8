"""One look at the scene: the colour image with registered depth, and the depth camera's own image. In ``base``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Observation
from config.schema import Station
from perception.geometry.depth import Rgbd, moved, registered, without_flying_pixels
from perception.scene.depth_view import DepthView
from perception.scene.normals import Surface, surface
from perception.scene.region import raised
from perception.scene.table import Table

Labels = npt.NDArray[np.int16]
Mask = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Look:
    """One observation, its flying pixels left out.

    Attributes:
        rgbd: the colour image with registered depth. ``source``: (H, W) the flat index of each of its pixels in the
            depth image, -1 = no depth. ``view``: the depth camera's own image.
        base_from_color: (4, 4) pose of the colour camera.
    """

    rgbd: Rgbd
    source: npt.NDArray[np.int32]
    view: DepthView
    base_from_color: Transform

    @classmethod
    def of(cls, observation: Observation, station: Station) -> Look:
        """Register the depth of one observation to its colour."""
        depth_m = without_flying_pixels(observation.frame.depth_m)
        rgbd, source = registered(observation.frame, depth_m)
        view = DepthView.of(observation, depth_m, station.camera.least_range_m)
        return cls(rgbd, source, view, observation.view.base_from_color)

    @cached_property
    def surface(self) -> Surface:
        """The smooth surfaces that the depth image shows, with their normals."""
        return surface(self.view)

    def in_color(self, labels: Labels) -> Labels:
        """Numbers (h, w) of the depth image's pixels in the colour image (H, W); 0 where it has no depth."""
        return np.where(self.source >= 0, labels.ravel()[self.source], 0).astype(np.int16)


@dataclass(frozen=True, eq=False)
class LookOnTable:
    """A look with its points in the table's frame.

    Attributes:
        points_table: (h, w, 3) [m] of the depth image, NaN = no depth.
        is_raised: (h, w) the depth pixels that may belong to objects.
    """

    look: Look
    points_table: Points
    is_raised: Mask

    @classmethod
    def of(cls, look: Look, table: Table, station: Station) -> LookOnTable:
        """Find out what rises above the table."""
        points_table = moved(look.view.points_base, table.table_from_base)
        return cls(look, points_table, raised(look.view.points_base, points_table[..., 2], station))

    @cached_property
    def lab(self) -> Points:
        """(h, w, 3) CIELAB of the raised pixels, from the colour pixels that they were registered to; 0 elsewhere."""
        source, out = self.look.source.ravel(), np.zeros((self.is_raised.size, 3), dtype=np.float32)
        at = np.flatnonzero(source >= 0)
        at = at[self.is_raised.ravel()[source[at]]]
        if len(at):
            color = self.look.rgbd.color.reshape(-1, 1, 3)[at]
            out[source[at]] = cv2.cvtColor(color, cv2.COLOR_RGB2LAB)[:, 0]
        return out.reshape(*self.is_raised.shape, 3)
