"""Names what keeps the jaw from a thing: rough depth, its width, a neighbour, unseen space, or its shape."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from bus.messages import Instance
from config.schema import Station
from perception.grasps.search import search
from perception.scene.heightmap import CELL_M
from perception.scene.scene import Scene

_TINY_M = 1e-6
_ROUGH_M, _NEAR_TABLE_M = 0.004, 0.05
"""Depth that scatters more on the table leaves no straight face anywhere; what is so near to it is the table."""
_UNSEEN_SHARE, _LOW_M = 0.1, 0.008


@dataclass(frozen=True)
class Cause:
    """An obstacle to the jaw, worded to stand after a colon, and the advice."""

    text: str
    advice: str


_TOO_WIDE = Cause(
    "wider than the jaw, without a narrower part that has room for a finger on either side",
    "Lay it so that a narrow part can be held with room for a finger on either side, or take it out by hand.",
)


_NEIGHBOUR = Cause(
    "something beside it is in the way of the fingers",
    "Make room for a finger on either side of it, or let what stands beside it be picked first.",
)
_NO_FACES = Cause(
    "it shows no two opposite faces, upright and parallel enough for the pads",
    "Lay it on another side, so that two opposite faces stand upright, or take it out by hand.",
)


def cause_on(one: Instance, scene: Scene, station: Station) -> Cause:
    """Return what is in the way of every grasp on a thing."""
    rough_m = _roughness_m(scene)
    if rough_m > _ROUGH_M:
        return Cause(
            f"its outline is ragged, since depth scatters by {rough_m * 1e3:.0f} mm on the table",
            "Look at the depth image: look from nearer, dull what shines, or check the camera.",
        )
    if one.size_m[1] >= station.hand.max_width_m:
        return _TOO_WIDE
    beside = _beside(one.number, scene, station)
    is_free_alone = _is_free_alone(one.number, scene, station)
    if is_free_alone and beside.occupied > beside.unseen:
        return _NEIGHBOUR
    if beside.unseen > _UNSEEN_SHARE:
        return Cause(
            f"of the space beside it {beside.unseen_m2 * 1e4:.0f} cm2 ({beside.unseen:.0%}) were not seen",
            "Look from above, or from another side, so that the space beside it is seen.",
        )
    return _NEIGHBOUR if is_free_alone else _NO_FACES


def _roughness_m(scene: Scene) -> float:
    """The scatter of what was seen of the table about its plane: a standard deviation, by the median."""
    height_m = scene.cloud.points_table[scene.cloud_labels == 0, 2]
    of_table = height_m[np.abs(height_m) < _NEAR_TABLE_M]
    return float(1.4826 * np.median(np.abs(of_table - np.median(of_table)))) if len(of_table) else 0.0


def _is_free_alone(number: int, scene: Scene, station: Station) -> bool:
    """Whether there would be a grasp if nothing else were there, seen or not."""
    heights = scene.heights
    mine = heights.labels == number
    surface_m = np.where(mine, heights.surface_m, np.float32(0))
    alone = replace(heights, surface_m=surface_m, bound_m=surface_m, labels=np.where(mine, heights.labels, np.int16(0)))
    return bool(np.isfinite(search(alone, station).score).any())


class _Beside(NamedTuple):
    """The space where fingers would stand: the shares of it that something else takes, and that was not seen."""

    occupied: float
    unseen: float
    unseen_m2: float


def _beside(number: int, scene: Scene, station: Station) -> _Beside:
    heights, hand = scene.heights, station.hand
    reach = round((station.perception.approach_clearance_m + hand.finger_thickness_m) / CELL_M)
    mine = (heights.labels == number).astype(np.uint8)
    around = (cv2.dilate(mine, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0) & (mine == 0)
    unseen = around & (heights.bound_m > heights.surface_m + _TINY_M)
    occupied = around & ~unseen & (heights.surface_m > _LOW_M)
    cells = max(int(around.sum()), 1)
    return _Beside(float(occupied.sum()) / cells, float(unseen.sum()) / cells, float(unseen.sum()) * CELL_M**2)
