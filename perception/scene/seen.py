"""The seen and the unseen: how much of the pick region, each thing on it, and whether an empty one is empty."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Instance, ObservedScene, SeenMount, SeenTable
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.crop import Crop
from perception.geometry.depth import Rgbd, moved
from perception.scene.heightmap import CELL_M
from perception.scene.look import Look
from perception.scene.scene import MIN_PIXELS, Scene
from perception.scene.table import Table

_CELL_M = 0.005
_HOLE_M2 = 3e-4
"""A hole in the depth this large may hide an object, when its colour is not the table's."""
_ANY_HOLE_M2 = 8e-4
"""A hole this large inside the seen table may hide one of the table's own colour, nearer than the camera measures."""
_COARSE_M = 0.032
"""Where the fewest pixels of a thing are a square wider than this, a table that looks empty may not be."""
_FOREIGN = 25.0
"""Squared standard deviations from the table's colour above which a pixel is not the table."""
_FOREIGN_SHARE = 0.3
_FEWEST, _SAMPLES = 20, 10_000
_BESIDE_PX, _BORDER_PX, _RIM_PX = 25, 3, 5
_OBJECT_M = 0.012

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Window = tuple[slice, slice]
"""Rows and columns of an image."""


@dataclass(frozen=True, eq=False)
class RegionView:
    """The pick region as the camera sees it, at points 5 mm apart on the seen table.

    Attributes:
        shape: (ny, nx). ``is_seen``: (ny, nx) the points where table or an object was measured.
        pixels: (n, 2) of the colour image. ``inside``: (ny, nx) the points inside that image.
    """

    scene: Scene
    shape: tuple[int, int]
    is_seen: Mask
    inside: Mask
    pixels: npt.NDArray[np.int64]

    @classmethod
    def of(cls, scene: Scene, station: Station) -> RegionView:
        """Project the region's points into the images."""
        x_min, x_max, y_min, y_max = station.scene.pick_region_m
        x_m, y_m = np.meshgrid(np.arange(x_min, x_max, _CELL_M), np.arange(y_min, y_max, _CELL_M))
        z_m = x_m * scene.table.slope_x + y_m * scene.table.slope_y + scene.table.height_m
        points = np.stack([x_m, y_m, z_m], axis=-1).reshape(-1, 3)
        is_seen = np.logical_or.reduce([_measured(look, points, scene.table) for look in scene.looks])
        in_color = apply(inverse(scene.base_from_color), points)
        scale = 1 / np.where(in_color[:, 2] > 0, in_color[:, 2], np.nan)
        model = scene.rgbd.camera
        u, v = in_color[:, 0] * scale * model.fx + model.cx, in_color[:, 1] * scale * model.fy + model.cy
        pixels = np.rint(np.nan_to_num(np.stack([u, v], axis=1), nan=-1.0)).astype(np.int64)
        inside = _inside(pixels, in_color[:, 2], (model.height, model.width))
        return cls(scene, x_m.shape, is_seen.reshape(x_m.shape), inside.reshape(x_m.shape), pixels)

    @property
    def share(self) -> float:
        """Share of the region that was seen."""
        return float(self.is_seen.mean())

    @cached_property
    def unseen(self) -> Mask:
        """(H, W) the pixels of the region, in the colour image, without depth."""
        rgbd = self.scene.rgbd
        u, v = np.where(self.inside.reshape(-1, 1), self.pixels, 0).T
        corners = cv2.convexHull(np.stack([u, v], axis=1)[self.inside.ravel()].astype(np.int32)) if u.any() else None
        region = np.zeros(rgbd.depth_m.shape, dtype=np.uint8)
        if corners is not None:
            cv2.fillConvexPoly(region, corners, 1)
        return np.asarray((region > 0) & np.isnan(rgbd.depth_m))

    def largest_suspect_hole_m2(self) -> float:
        """Area [m2] of the largest hole that may hide an object: of another colour than the table's, or large and with
        the seen table all around it; 0 for none.
        """
        holes = self.inside & ~self.is_seen
        opened = cv2.morphologyEx(holes.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        count, labels = cv2.connectedComponents(opened)
        at_border = {int(label) for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]) for label in edge}
        areas_m2 = [float((labels == label).sum()) * _CELL_M**2 for label in range(count)]
        suspect = [
            area_m2
            for label, area_m2 in enumerate(areas_m2)
            if label > 0
            and (
                self._foreign[labels == label].mean() > _FOREIGN_SHARE
                or (area_m2 > _ANY_HOLE_M2 and label not in at_border)
            )
        ]
        return max(suspect, default=0.0)

    @cached_property
    def _foreign(self) -> Mask:
        """(ny, nx) the points whose colour is not the table's; none when too little of it was seen."""
        seen = self.is_seen & self.inside
        if seen.sum() < _FEWEST:
            return np.zeros(self.shape, dtype=bool)
        lab = cv2.cvtColor(cv2.blur(self.scene.rgbd.color, (5, 5)), cv2.COLOR_RGB2LAB)
        u, v = np.where(self.inside.reshape(-1, 1), self.pixels, 0).T
        sampled = lab[v, u].reshape(*self.shape, 3).astype(float)
        return np.asarray(_apart(sampled, sampled[seen]) > _FOREIGN)


def _measured(look: Look, points_base: Array, table: Table) -> Mask:
    """Return where (n,) a look measured the table, or what is above it, towards points (n, 3) of the table."""
    pixels, z = look.view.pixels(points_base.astype(np.float32))
    measured = look.view.inside(pixels, z)
    u, v = np.where(measured[:, None], pixels, 0).T
    height_m = moved(look.view.points_base[v, u][None], table.table_from_base)[0, :, 2]
    return np.asarray(measured & (height_m > -_OBJECT_M))


def described(scene: Scene, region: RegionView, mount: SeenMount | None = None) -> ObservedScene:
    """Return the scene as a message; ``mount``: how its looks disagreed."""
    table = scene.table
    return ObservedScene(
        table=SeenTable(base_from_table=table.base_from_table, offset_m=table.offset_m, tilt_rad=table.tilt_rad),
        region_seen=region.share,
        instances=_instances(scene),
        labels=_with_rims(scene, scene.shown),
        unseen=region.unseen,
        shown=scene.shown,
        further_labels=tuple(_with_rims(scene, index) for index in range(len(scene.looks)) if index != scene.shown),
        mount=mount,
    )


def require_something(scene: Scene, region: RegionView, station: Station) -> None:
    """End the detection of a pick region in which nothing rises above the table.

    Raises:
        CycleFailure: NO_OBJECT when enough of the table was seen and no hole hides anything; NO_DEPTH for a hole of
            another colour than the table's; NOT_SEEN when too little was seen, or too coarsely.
    """
    if scene.count:
        return
    needed = station.perception.min_table_seen
    hole_m2 = region.largest_suspect_hole_m2()
    if hole_m2 > _HOLE_M2:
        raise CycleFailure(
            Code.NO_DEPTH,
            f"Nothing rises above the table, but {hole_m2 * 1e4:.0f} cm2 of it have no depth: glass, something black or"
            " shiny, or nearer than the camera measures?",
        )
    if region.share < needed:
        raise CycleFailure(
            Code.NOT_SEEN,
            f"Nothing rises above the table, but only {region.share:.0%} of the pick region was seen;"
            f" {needed:.0%} are needed.",
        )
    least_m = MIN_PIXELS**0.5 * min(look.view.pixel_m for look in scene.looks)
    if least_m > _COARSE_M:
        raise CycleFailure(
            Code.NOT_SEEN,
            "Nothing rises above the table, but the depth has so few pixels that a thing of less than"
            f" {least_m * 1e3:.0f} x {least_m * 1e3:.0f} mm is not noticed: look from nearer, or with more pixels.",
        )
    raise CycleFailure(
        Code.NO_OBJECT, f"Nothing rises above the table inside the pick region, of which {region.share:.0%} was seen."
    )


def _with_rims(scene: Scene, look: int) -> npt.NDArray[np.uint8]:
    """The numbers (H, W) of the things in one look, also in pixels without depth at their rims."""
    labels = scene.all_color_labels[look].astype(np.uint8)
    around = cv2.dilate(labels, np.ones((_RIM_PX, _RIM_PX), np.uint8))
    return np.where((labels == 0) & np.isnan(scene.looks[look].rgbd.depth_m), around, labels)


def _instances(scene: Scene) -> tuple[Instance, ...]:
    """Place, size and completeness of every thing."""
    whole, shares = _in_view(scene), _depth_shares(scene)
    instances = []
    for number, ours in enumerate(_groups(scene.cloud_labels, scene.count), start=1):
        top, size_m = _extent(scene.cloud.points_table[ours].astype(float))
        instances.append(
            Instance(
                number=number,
                top_m=apply(scene.table.base_from_table, top[None])[0],
                size_m=size_m,
                in_view=number in whole,
                depth_share=shares[number - 1],
            )
        )
    return tuple(instances)


def _groups(labels: npt.NDArray[np.int16], count: int) -> list[npt.NDArray[np.intp]]:
    """The indices of the points of every number from 1 to ``count``, of labels (n,)."""
    at = np.flatnonzero(labels)
    at = at[np.argsort(labels[at], kind="stable")]
    return np.split(at, np.cumsum(np.bincount(labels[at], minlength=count + 1)[1:-1]))[:count]


def _extent(points: Array) -> tuple[Array, Array]:
    """The highest of the points (n, 3) of a thing, and its size (3,): longer side, shorter side, height."""
    few = points[:: max(1, len(points) // _SAMPLES), :2].astype(np.float32)
    (_, (one_m, other_m), _) = cv2.minAreaRect(few)
    top = points[points[:, 2].argmax()]
    return top, np.array([max(one_m, other_m), min(one_m, other_m), top[2]]) + np.array([CELL_M, CELL_M, 0.0]) / 2


def _in_view(scene: Scene) -> set[int]:
    """The things that one of the looks shows without that the border of its colour or depth image cuts them."""
    whole: set[int] = set()
    for look_labels, color_labels in zip(scene.look_labels, scene.all_color_labels, strict=True):
        whole |= set(np.unique(look_labels).tolist()) - _at_border(look_labels) - _at_border(color_labels)
    return whole


def _at_border(labels: npt.NDArray[np.int16]) -> set[int]:
    rim = np.ones(labels.shape, dtype=bool)
    rim[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = False
    return set(np.unique(labels[rim]).tolist())


def _depth_shares(scene: Scene) -> list[float]:
    """Of each thing, the share of its pixels that have depth, in the look where that is greatest."""
    shares = [
        [
            0.0 if window is None else _depth_share(look.rgbd, labels, number, window)
            for number, window in enumerate(ndimage.find_objects(labels, scene.count), start=1)
        ]
        for look, labels in zip(scene.looks, scene.all_color_labels, strict=True)
    ]
    return [max(of_looks) or 1.0 for of_looks in zip(*shares, strict=True)]  # 0: no look has colour there


def _depth_share(rgbd: Rgbd, labels: npt.NDArray[np.int16], number: int, window: Window) -> float:
    """Share of the thing's pixels with depth; those without are beside it and have its colour."""
    crop = Crop.enclosing(window, labels.shape, _BESIDE_PX)
    mask = crop.of(labels)[::2, ::2] == number
    hole = np.isnan(crop.of(rgbd.depth_m))[::2, ::2]
    lab = cv2.cvtColor(cv2.blur(crop.of(rgbd.color), (3, 3)), cv2.COLOR_RGB2LAB)[::2, ::2].astype(float)
    rest = ~mask & ~hole
    if rest.sum() < _FEWEST or mask.sum() < _FEWEST:
        return 1.0
    missing = hole & (_apart(lab, lab[mask]) < _apart(lab, lab[rest]))
    return float(mask.sum() / (mask.sum() + missing.sum()))


def _apart(lab: npt.NDArray[np.float64], samples: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Squared standard deviations (...) of colours (..., 3) from the mean of samples (n, 3)."""
    mean, covariance = samples.mean(axis=0), np.cov(samples.T) + 4.0 * np.eye(3)
    off = lab - mean
    return np.asarray((off @ np.linalg.inv(covariance) * off).sum(axis=-1))


def _inside(pixels: npt.NDArray[np.integer], z: npt.NDArray[np.floating], shape: tuple[int, int]) -> Mask:
    u, v = pixels.T
    return np.asarray((z > 0) & (u >= 0) & (v >= 0) & (u < shape[1]) & (v < shape[0]))
