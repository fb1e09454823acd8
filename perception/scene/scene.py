"""One model of the scene, made once per observation: the table, the things on it, and what was not seen.

The table's frame has z along its seen normal; see `perception.scene.table` and docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Observation
from bus.transforms import inverse
from config.schema import Station
from perception.geometry.depth import Rgbd, moved, registered, without_flying_pixels
from perception.scene.depth_view import DepthView
from perception.scene.heightmap import Grid, HeightMap, Heights, Labels, Seen, bound, highest
from perception.scene.outline import outlined
from perception.scene.region import raised, region_corners_m, within
from perception.scene.splitting import color_patches, pieces, things
from perception.scene.table import Table, find_table

_MIN_PIXELS = 60
"""A thing lies in the pick region when so many of its depth pixels do, and the share below of them."""
_INSIDE_SHARE = 0.25
_MOST = 255
_SPARSE_CELLS = 1.5
"""A cell without a point has that of the nearest cell so far away: seen at an angle, a surface's points lie apart."""

Mask = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Scene:
    """What was seen, in the table's frame.

    Attributes:
        rgbd: the colour image with registered depth. ``source``: (H, W) the flat index of each of its pixels in the
            depth image, -1 = no depth. ``view``: the depth camera's own image.
        base_from_color: (4, 4) pose of the colour camera.
        points_table: (h, w, 3) [m] of the depth image in the table's frame, NaN = no depth.
        is_raised: (h, w) the depth pixels that may belong to objects. ``lab``: (h, w, 3) their CIELAB colour.
        labels: (h, w) the number of the thing in each depth pixel, 0 = none.
        heights: the height map from above, with the same numbers.
    """

    rgbd: Rgbd
    source: npt.NDArray[np.int32]
    view: DepthView
    base_from_color: Transform
    table: Table
    points_table: Points
    is_raised: Mask
    lab: Points
    labels: Labels
    heights: HeightMap

    @property
    def count(self) -> int:
        """How many things there are; they are numbered from 1 on."""
        return int(self.heights.labels.max(initial=0))

    @cached_property
    def color_labels(self) -> Labels:
        """(H, W) the number of the thing in each pixel of the colour image that has depth, 0 = none."""
        return np.where(self.source >= 0, self.labels.ravel()[self.source], 0).astype(np.int16)

    @cached_property
    def height_m(self) -> npt.NDArray[np.float32]:
        """(H, W) height above the table of each pixel of the colour image, NaN = no depth."""
        height_m = self.points_table[..., 2].ravel()[self.source]
        return np.where(self.source >= 0, height_m, np.float32(np.nan))

    def outline(self, instance: int) -> Mask:
        """(H, W) outline of a thing in the colour image, its holes closed and its rim redrawn by colour."""
        return outlined(self.color_labels == instance, np.isfinite(self.rgbd.depth_m), self.rgbd.color)

    def heights_along(self, base_from_level: Transform, instance: int) -> HeightMap:
        """The height map around one thing, seen against the z axis of a level frame (4, 4); each thing is one piece."""
        points = moved(self.view.points_base, inverse(base_from_level))
        grid = Grid.around(points[self.labels == instance][:, :2])
        seen = highest(grid, points.reshape(-1, 3))
        surface_m, bound_m = _heights(seen, grid, self.view, base_from_level)
        point, labels = seen.point_within(_SPARSE_CELLS), np.zeros(grid.shape, dtype=np.int16)
        labels[point >= 0] = self.labels.ravel()[point[point >= 0]]
        return HeightMap(surface_m, bound_m, labels, labels, labels, grid.origin_m)


def observe(observation: Observation, station: Station) -> Scene:
    """Make the model of one observation. Raises: CycleFailure(NO_TABLE, TOO_NEAR) when no table is seen."""
    depth_m = without_flying_pixels(observation.frame.depth_m)
    (rgbd, source), view = registered(observation.frame, depth_m), DepthView.of(observation, depth_m)
    table = find_table(view.points_base, station)
    points_table = moved(view.points_base, table.table_from_base)
    is_raised = raised(view.points_base, points_table[..., 2], station)
    lab = _lab(rgbd, source, is_raised)
    footprint = points_table[is_raised][:, :2] if is_raised.any() else region_corners_m(station)
    grid = Grid.around(footprint)
    heights = _height_map(view, grid, points_table, lab, is_raised, table.base_from_table)
    heights = _without_tall(heights, station.scene.max_height_m)
    heights, labels = _in_region(heights, grid, points_table, is_raised, within(view.points_base, station))
    return Scene(
        rgbd, source, view, observation.view.base_from_color, table, points_table, is_raised, lab, labels, heights
    )


def _height_map(
    view: DepthView, grid: Grid, points_level: Points, lab: Points, is_raised: Mask, base_from_level: Transform
) -> HeightMap:
    """The height map of points (h, w, 3) in a level frame."""
    seen = highest(grid, points_level.reshape(-1, 3))
    point = seen.point_within(_SPARSE_CELLS)
    raised_cells, cell_lab = point >= 0, np.zeros((*grid.shape, 3), dtype=np.float32)
    raised_cells[raised_cells] = is_raised.ravel()[point[raised_cells]]
    cell_lab[raised_cells] = lab.reshape(-1, 3)[point[raised_cells]]
    surface_m, bound_m = _heights(seen, grid, view, base_from_level)
    parts = pieces(surface_m, raised_cells)
    return HeightMap(
        surface_m, bound_m, things(parts, cell_lab), parts, color_patches(cell_lab, raised_cells), grid.origin_m
    )


def _heights(seen: Seen, grid: Grid, view: DepthView, base_from_level: Transform) -> tuple[Heights, Heights]:
    """Surface and bound (ny, nx): see `HeightMap`."""
    bound_m = bound(grid, seen.height_m, view, base_from_level)
    return np.where(np.isinf(seen.height_m), np.minimum(seen.continued_m, bound_m), seen.height_m), bound_m


def _without_tall(heights: HeightMap, max_height_m: float) -> HeightMap:
    """The map without the things that reach above ``max_height_m``: the arm and a camera stand begin lower down."""
    tall = cv2.dilate((heights.surface_m > max_height_m).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    if not tall.any():
        return heights
    reaching = np.unique(heights.labels[tall])
    return replace(heights, labels=np.where(np.isin(heights.labels, reaching), 0, heights.labels).astype(np.int16))


def _in_region(
    heights: HeightMap, grid: Grid, points_table: Points, is_raised: Mask, inside: Mask
) -> tuple[HeightMap, Labels]:
    """The map and the depth pixels (h, w), numbered are only the things that lie in the pick region."""
    labels = np.zeros(is_raised.shape, dtype=np.int16)
    labels[is_raised] = heights.labels.ravel()[grid.index(points_table[is_raised][:, :2])]
    pixels = np.bincount(labels[inside & is_raised], minlength=int(heights.labels.max(initial=0)) + 1)
    pixels[0] = 0
    whole = np.maximum(np.bincount(labels[is_raised], minlength=len(pixels)), 1)
    kept = np.flatnonzero((pixels >= _MIN_PIXELS) & (pixels >= _INSIDE_SHARE * whole))[:_MOST]
    number = np.zeros(len(pixels), dtype=np.int16)
    number[kept] = np.arange(1, len(kept) + 1)
    return replace(heights, labels=number[heights.labels]), number[labels]


def _lab(rgbd: Rgbd, source: npt.NDArray[np.int32], is_raised: Mask) -> Points:
    """CIELAB (h, w, 3) of the raised depth pixels, from the colour pixels that they were registered to; 0 elsewhere."""
    out = np.zeros((is_raised.size, 3), dtype=np.float32)
    at = np.flatnonzero(source.ravel() >= 0)
    at = at[is_raised.ravel()[source.ravel()[at]]]
    if len(at):
        out[source.ravel()[at]] = cv2.cvtColor(rgbd.color.reshape(-1, 1, 3)[at], cv2.COLOR_RGB2LAB)[:, 0]
    return out.reshape(*is_raised.shape, 3)
