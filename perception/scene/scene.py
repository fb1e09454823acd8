"""One model of the scene, made of one look or several: the table, the things on it, and what was not seen.

The table's frame has z along its seen normal; see `perception.scene.table` and docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Observation
from bus.transforms import from_translation, inverse
from config.schema import Station
from perception.geometry.depth import Rgbd, moved
from perception.scene.cloud import Cloud
from perception.scene.depth_view import DepthView
from perception.scene.heightmap import Grid, HeightMap, Heights, Labels, Seen, bound, highest, in_shadow
from perception.scene.look import Look, LookOnTable
from perception.scene.outline import outlined
from perception.scene.region import region_corners_m, within
from perception.scene.splitting import color_patches, pieces, things
from perception.scene.table import Table, find_table

MIN_PIXELS = 60
"""A thing lies in the pick region when so many of its points do, and the share below of them."""
_INSIDE_SHARE = 0.25
_MOST = 255
_SPARSE_CELLS = 1.5
"""A cell without a point has that of the nearest cell so far away: seen at an angle, a surface's points lie apart."""
_ASLANT_RAD = float(np.deg2rad(17))
"""A camera that leans less looks from above: at 15 degrees, nothing is gained by what `HeightMap.is_aslant` says. The
Femto Mega's depth lens leans by 6 degrees, a table by up to 3."""
_MORE = 1.2
"""Another look than the first is shown to the models when it sees so many times more of the things."""

Mask = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Scene:
    """The scene as it was seen, in the table's frame.

    Attributes:
        looks: as many as there were observations. ``shown``: index of the one that models and people are shown.
        cloud: the points of all looks. ``cloud_labels``: (n,) the number of the thing of each, 0 = none.
        look_labels: of each look, (h, w) the number of the thing in each depth pixel, 0 = none.
        heights: the height map from above, with the same numbers.
    """

    looks: tuple[Look, ...]
    shown: int
    table: Table
    cloud: Cloud
    cloud_labels: Labels
    look_labels: tuple[Labels, ...]
    heights: HeightMap

    @property
    def look(self) -> Look:
        """The look that is shown."""
        return self.looks[self.shown]

    @property
    def rgbd(self) -> Rgbd:
        """The colour image with registered depth, of the look that is shown."""
        return self.look.rgbd

    @property
    def view(self) -> DepthView:
        """The depth image of the look that is shown."""
        return self.look.view

    @property
    def base_from_color(self) -> Transform:
        """(4, 4) pose of the colour camera, of the look that is shown."""
        return self.look.base_from_color

    @property
    def labels(self) -> Labels:
        """(h, w) the number of the thing in each depth pixel, of the look that is shown."""
        return self.look_labels[self.shown]

    @property
    def is_aslant(self) -> bool:
        """As `HeightMap.is_aslant`, of every map of the scene."""
        return self.heights.is_aslant

    @property
    def lean_rad(self) -> float:
        """The angle between the camera's axis and straight down, of the look that is shown."""
        return _lean_rad(self.look, self.table)

    @property
    def count(self) -> int:
        """The number of things; they are numbered from 1 on."""
        return int(self.heights.labels.max(initial=0))

    @cached_property
    def all_color_labels(self) -> tuple[Labels, ...]:
        """Of each look, (H, W) the number of the thing in each pixel of the colour image that has depth, 0 = none."""
        return tuple(look.in_color(labels) for look, labels in zip(self.looks, self.look_labels, strict=True))

    @property
    def color_labels(self) -> Labels:
        """`all_color_labels` of the look that is shown."""
        return self.all_color_labels[self.shown]

    @cached_property
    def height_m(self) -> npt.NDArray[np.float32]:
        """(H, W) height above the table of each pixel of the colour image, NaN = no depth; of the look shown."""
        height_m = moved(self.view.points_base, self.table.table_from_base)[..., 2].ravel()[self.look.source]
        return np.where(self.look.source >= 0, height_m, np.float32(np.nan))

    def outline(self, instance: int) -> Mask:
        """(H, W) outline of a thing in the colour image, its holes closed and its rim redrawn by colour."""
        return outlined(self.color_labels == instance, np.isfinite(self.rgbd.depth_m), self.rgbd.color)

    def along(self, base_from_level: Transform, instance: int) -> tuple[HeightMap, Transform]:
        """Return the height map around a thing, seen against the z axis of a level frame (4, 4); each thing is a piece.

        Returns: the map, and its own level frame: the one given, with the origin moved along z to the thing's far end.
        """
        points = moved(self.cloud.points_table[None], inverse(base_from_level) @ self.table.base_from_table)[0]
        ours = points[self.cloud_labels == instance]
        far_m = float(ours[:, 2].min())
        points[:, 2] -= np.float32(far_m)
        base_from_level = base_from_level @ from_translation((0.0, 0.0, far_m))
        grid = Grid.around(ours[:, :2])
        seen = highest(grid, points, self.cloud.weights)
        surface_m, bound_m = _heights(seen, grid, self.looks, base_from_level, self.is_aslant)
        point, labels = seen.point_within(_SPARSE_CELLS), np.zeros(grid.shape, dtype=np.int16)
        labels[point >= 0] = self.cloud_labels[point[point >= 0]]
        up_xy = (base_from_level[:3, :3].T @ self.table.base_from_table[:3, 2])[:2]
        return HeightMap(
            surface_m, bound_m, labels, labels, labels, grid.origin_m, up_xy, self.is_aslant
        ), base_from_level


def observe(observation: Observation, station: Station) -> Scene:
    """Make the model of one observation. Raises: CycleFailure(NO_TABLE, TOO_NEAR) when no table is seen."""
    return scene_of([Look.of(observation, station)], station)


def scene_of(looks: Sequence[Look], station: Station) -> Scene:
    """Make the model of one look, or several that agree.

    Raises: CycleFailure(NO_TABLE, TOO_NEAR) when no table is seen.
    """
    looks = tuple(looks)
    table = find_table(np.concatenate([look.view.points_base for look in looks]), station)
    on_table = tuple(LookOnTable.of(look, table, station) for look in looks)
    cloud = Cloud.of(on_table, table, station)
    risen = cloud.points_table[cloud.is_raised][:, :2]
    grid = Grid.around(risen if len(risen) else region_corners_m(station))
    heights = _without_tall(_height_map(looks, grid, cloud, table), station.scene.max_height_m)
    heights = _in_region(
        heights, grid, cloud, within(moved(cloud.points_table[None], table.base_from_table)[0], station)
    )
    cloud_labels = _labels(heights, grid, cloud.points_table, cloud.is_raised)
    look_labels = tuple(_labels(heights, grid, one.points_table, one.is_raised) for one in on_table)
    return Scene(looks, _best(on_table, look_labels, grid), table, cloud, cloud_labels, look_labels, heights)


def _height_map(looks: tuple[Look, ...], grid: Grid, cloud: Cloud, table: Table) -> HeightMap:
    """The height map of a cloud, from above."""
    seen = highest(grid, cloud.points_table, cloud.weights)
    point = seen.point_within(_SPARSE_CELLS)
    raised_cells, cell_lab = point >= 0, np.zeros((*grid.shape, 3), dtype=np.float32)
    raised_cells[raised_cells] = cloud.is_raised[point[raised_cells]]
    cell_lab[raised_cells] = cloud.lab[point[raised_cells]]
    is_aslant = len(looks) == 1 and _lean_rad(looks[0], table) > _ASLANT_RAD
    surface_m, bound_m = _heights(seen, grid, looks, table.base_from_table, is_aslant)
    parts = pieces(surface_m, raised_cells)
    return HeightMap(
        surface_m,
        bound_m,
        things(parts, cell_lab),
        parts,
        color_patches(cell_lab, raised_cells),
        grid.origin_m,
        is_aslant=is_aslant,
    )


def _heights(
    seen: Seen, grid: Grid, looks: tuple[Look, ...], base_from_level: Transform, is_aslant: bool
) -> tuple[Heights, Heights]:
    """Surface and bound (ny, nx): see `HeightMap`."""
    bound_m = bound(grid, seen.height_m, tuple(look.view for look in looks), base_from_level)
    surface_m = np.where(np.isinf(seen.height_m), np.minimum(seen.continued_m, bound_m), seen.height_m)
    if is_aslant:
        surface_m[in_shadow(grid, seen, looks[0].view, base_from_level)] = 0.0
    return surface_m, bound_m


def _lean_rad(look: Look, table: Table) -> float:
    """The angle between a camera's axis and the way straight down to the table."""
    return float(np.arccos(np.clip(-look.view.base_from_depth[:3, 2] @ table.base_from_table[:3, 2], -1, 1)))


def _without_tall(heights: HeightMap, max_height_m: float) -> HeightMap:
    """The map without the things that reach above ``max_height_m``: the arm and a camera stand begin lower down."""
    tall = cv2.dilate((heights.surface_m > max_height_m).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    if not tall.any():
        return heights
    reaching = np.unique(heights.labels[tall])
    return replace(heights, labels=np.where(np.isin(heights.labels, reaching), 0, heights.labels).astype(np.int16))


def _in_region(heights: HeightMap, grid: Grid, cloud: Cloud, inside: Mask) -> HeightMap:
    """The map, numbered are only the things that lie in the pick region; ``inside``: (n,) the points there."""
    labels = _labels(heights, grid, cloud.points_table, cloud.is_raised)[cloud.is_raised]
    whole = np.bincount(labels, minlength=int(heights.labels.max(initial=0)) + 1)
    pixels = np.bincount(labels[inside[cloud.is_raised]], minlength=len(whole))
    pixels[0] = 0
    kept = np.flatnonzero((pixels >= MIN_PIXELS) & (pixels >= _INSIDE_SHARE * np.maximum(whole, 1)))[:_MOST]
    number = np.zeros(len(pixels), dtype=np.int16)
    number[kept] = np.arange(1, len(kept) + 1)
    return replace(heights, labels=number[heights.labels])


def _labels(heights: HeightMap, grid: Grid, points_table: Points, is_raised: Mask) -> Labels:
    """The number (...) of the thing of each raised point (..., 3), 0 = none."""
    labels = np.zeros(is_raised.shape, dtype=np.int16)
    cell = grid.index(points_table[is_raised][:, :2])
    labels[is_raised] = np.where(cell >= 0, heights.labels.ravel()[cell], 0)
    return labels


def _best(looks: tuple[LookOnTable, ...], labels: tuple[Labels, ...], grid: Grid) -> int:
    """The look that shows the most of the things, counted in cells; the first one unless another shows clearly more."""
    if len(looks) == 1:
        return 0
    cells = [
        len(np.unique(grid.index(one.points_table[numbers > 0][:, :2])))
        for one, numbers in zip(looks, labels, strict=True)
    ]
    best = int(np.argmax(cells))
    return best if cells[best] > _MORE * cells[0] else 0
