"""A contact sheet of judged scenes: the picture, the grasp as it would truly be, and what the judge says of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.heaps.figures import REFUSED, Row
from benchmarks.heaps.heap import Heap
from benchmarks.heaps.judge import TRUE
from benchmarks.heaps.swept import PALM_SIZE_M
from benchmarks.sheet import write_sheet
from bus.transforms import apply, inverse
from config.devices import HandSettings
from config.franka_hand import FINGER_TIP_M, PALM_ABOVE_TIP_M
from drivers.sim.optics import COLOR

_COLUMNS, _TILE_PX = 5, (360, 300)
_AROUND_M = 0.05
_GOOD, _BAD, _NONE, _PALM = (40, 160, 30), (30, 30, 220), (0, 140, 255), (120, 120, 120)  # BGR

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]


def tile(heap: Heap, row: Row) -> Image:
    """Return the pick region in BGR, with fingers, jaw line and palm of the best grasp, and the verdict."""
    image = np.ascontiguousarray(heap.color[..., ::-1])
    color = _GOOD if row.outcome == TRUE else _NONE if row.outcome == REFUSED else _BAD
    if row.pose is not None:
        _draw(image, heap, np.array(row.pose), row.opening_m, color)
    x_min, x_max, y_min, y_max = heap.station().scene.pick_region_m
    around = np.array([[x, y, 0.0] for x in (x_min, x_max) for y in (y_min, y_max)])
    around[:, :2] += np.sign(around[:, :2] - around[:, :2].mean(axis=0)) * _AROUND_M
    seen = _pixels(heap, around)
    (left, top), (right, bottom) = np.maximum(seen.min(axis=0), 0), seen.max(axis=0)
    small = np.asarray(
        cv2.resize(image[top:bottom, left:right], _TILE_PX, interpolation=cv2.INTER_AREA), dtype=np.uint8
    )
    possible = {True: "", False: " infeasible", None: " ?"}[heap.feasible]
    _write(small, f"{row.group} s{row.seed} {row.kind} {row.pair}{possible}", 14, (0, 0, 0))
    physics = {True: " (lifted)", False: " (lost)", None: ""}[row.lifted]
    _write(small, f"{row.outcome}{physics} {row.why}"[:52], 30, color)
    return small


def write_tiles(path: Path, tiles: Sequence[Image]) -> None:
    """Write the sheet."""
    write_sheet(path, tiles, _COLUMNS)


def _draw(image: Image, heap: Heap, base_from_tcp: Array, opening_m: float, color: tuple[int, int, int]) -> None:
    hand = heap.station().hand
    for outline, pen in ((_palm(), _PALM), *((finger, color) for finger in _fingers(hand, opening_m))):
        cv2.polylines(image, [_pixels(heap, apply(base_from_tcp, outline))], True, pen, 2, cv2.LINE_AA)
    jaw = np.array([[0.0, side * opening_m / 2, FINGER_TIP_M] for side in (-1, 1)])
    cv2.polylines(image, [_pixels(heap, apply(base_from_tcp, jaw))], False, color, 1, cv2.LINE_AA)


def _fingers(hand: HandSettings, opening_m: float) -> list[Array]:
    x_m = hand.finger_width_m / 2
    ends = [sorted((side * opening_m / 2, side * (opening_m / 2 + hand.finger_thickness_m))) for side in (-1, 1)]
    return [_rectangle((-x_m, x_m), (low, high), FINGER_TIP_M) for low, high in ends]


def _palm() -> Array:
    x_m, y_m = PALM_SIZE_M[0] / 2, PALM_SIZE_M[1] / 2
    return _rectangle((-x_m, x_m), (-y_m, y_m), FINGER_TIP_M - PALM_ABOVE_TIP_M)


def _rectangle(x_m: tuple[float, float], y_m: tuple[float, float], z_m: float) -> Array:
    return np.array([[x, y, z_m] for x, y in ((x_m[0], y_m[0]), (x_m[1], y_m[0]), (x_m[1], y_m[1]), (x_m[0], y_m[1]))])


def _pixels(heap: Heap, points_base: Array) -> npt.NDArray[np.int32]:
    """Return where the camera truly sees points (n, 3) in ``base``: (n, 2) whole pixels."""
    points = apply(inverse(heap.true_base_from_color), points_base)
    matrix = np.array([[COLOR.fx, 0, COLOR.cx], [0, COLOR.fy, COLOR.cy], [0, 0, 1]])
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(COLOR.distortion))
    return np.asarray(np.rint(pixels[:, 0]), dtype=np.int32)


def _write(image: Image, text: str, y_px: int, color: tuple[int, int, int]) -> None:
    (width_px, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)
    cv2.rectangle(image, (0, y_px - 12), (width_px + 10, y_px + 4), (255, 255, 255), -1)
    cv2.putText(image, text, (5, y_px), cv2.FONT_HERSHEY_SIMPLEX, 0.42, color, 1, cv2.LINE_AA)
