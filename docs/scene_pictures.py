"""Draws the scenes of docs/method.md: a heap, a tilted table, refusals: ``uv run python -m docs.scene_pictures``.

The things below are dropped and photographed by `benchmarks.heaps`, as the simulated camera sees them; what is drawn is
what `perception.detector.detect` made of it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

os.environ.setdefault("MUJOCO_GL", "egl")  # headless; MuJoCo reads it when it is first imported

from benchmarks.heaps.heap import make
from benchmarks.heaps.shapes import Shape
from bus.errors import CycleFailure
from bus.messages import Detections, Grasp, ObservedScene
from bus.transforms import apply
from config.franka_hand import FINGER_LENGTH_M, FINGER_TIP_M
from config.schema import Station
from docs.chart import FAINT, Array, Chart, Image, blank
from docs.heap_shapes import HEAP, TALL, WIDE
from docs.tiles import column, row, save, titled
from logs.report.images import annotated, crop
from logs.scene_picture import color_of, draw_scene
from perception.detector import detect, ignore_reply
from perception.grasps.rank import graded
from perception.grasps.search import search
from perception.models import open_models
from perception.scene.heightmap import CELL_M, HeightMap
from perception.scene.scene import Scene, observe

FOLDER = Path(__file__).parent / "method"
HEIGHT_PX, MARGIN_PX = 300, 70
SEEN_RGB, HAND_RGB, STATION_RGB, HIDDEN_RGB = (47, 111, 222), (31, 138, 91), (196, 61, 92), (60, 66, 74)
_SLICE_M = 0.012
_CLOSINGS = 150
HEAP_SEED, TILTED_SEED, REFUSED_SEED = 2, 52, 4
TABLE_ELSEWHERE = 'scene.table={name="table", center_m=[0.45, 0.0, -0.045], size_m=[0.9, 1.4, 0.04]}'


@dataclass(frozen=True)
class Look:
    """One scene, and what detect made of it: ``found`` or ``failure``."""

    station: Station
    scene: Scene
    seen: ObservedScene
    found: Detections | None
    failure: CycleFailure | None

    @property
    def color(self) -> Image:
        """(H, W, 3) undistorted."""
        return self.scene.rgbd.color


def look(shapes: tuple[Shape, ...], seed: int, *overrides: str) -> Look:
    """Drop the shapes and detect."""
    heap = make(len(shapes), seed, shapes)
    station, observation, seen = heap.station(overrides), heap.observation(), list[ObservedScene]()
    scene = observe(observation, station)
    try:
        found = detect(observation, station, open_models(station, {}), ignore_reply, on_scene=seen.append)
    except CycleFailure as failure:
        return Look(station, scene, seen[0], None, failure)
    return Look(station, scene, seen[0], found, None)


def main() -> None:
    """Draw all of them."""
    save(heap_picture(look(HEAP, HEAP_SEED)), FOLDER / "heap.jpg")
    save(table_picture(look((HEAP[0],), TILTED_SEED)), FOLDER / "table.jpg")
    refused = [
        look((TALL,), REFUSED_SEED),
        look((WIDE,), REFUSED_SEED),
        look((HEAP[0],), REFUSED_SEED, TABLE_ELSEWHERE),
    ]
    save(row([_refusal(one) for one in refused]), FOLDER / "refusals.jpg")


# --- heap -------------------------------------------------------------------------------------------------------------


def heap_picture(one: Look) -> Image:
    """Four tiles: the image, the things, the heights with the closings, the grasps."""
    assert one.found is not None
    things, grasps = draw_scene(one.color, one.seen), annotated(one.found, 0, ())
    near, mask = [one.color, things, grasps], one.seen.labels > 0
    color, things, grasps = (crop(image, mask, MARGIN_PX) for image in near)
    return column(
        [
            row([
                titled("what the camera saw", color, HEIGHT_PX),
                titled("its things, numbered; hatched: not seen", things, HEIGHT_PX),
            ]),
            row([
                titled("heights, and where the jaw could close", _heights(one, color.shape), HEIGHT_PX),
                titled("grasps of the imagined rods, the best yellow", grasps, HEIGHT_PX),
            ]),
        ]
    )  # fmt: skip


def _heights(one: Look, shape: tuple[int, ...]) -> Image:
    """The height map from above, unseen cells that may be occupied dark, with the search's closings."""
    heights, image = one.scene.heights, blank(shape[1], shape[0])
    (x, y), (rows, columns) = heights.origin_m, heights.surface_m.shape
    ends_x, ends_y = (x, x + columns * CELL_M), (y, y + rows * CELL_M)
    low, high = things_m(heights, shape[1] / shape[0])
    chart = Chart(image, (0, 0, shape[1] - 1, shape[0] - 1), x=(high[1], low[1]), y=(low[0], high[0]))
    chart.cells(shaded(heights), ends_y, ends_x)
    closings = graded(search(heights, one.station), one.seen.instances)
    for index in closings.distinct(_CLOSINGS):
        heading, half_m = closings.heading_rad[index], closings.width_m[index] / 2
        along = half_m * np.array([np.cos(heading), np.sin(heading)])
        ends = np.stack([closings.center_m[index] - along, closings.center_m[index] + along])
        chart.curve(ends[:, 1], ends[:, 0], (255, 255, 255))
    return image


def things_m(heights: HeightMap, aspect: float) -> tuple[Array, Array]:
    """The lowest and the highest (x, y) around the things, ``aspect`` times as long in y as in x."""
    rows, columns = np.nonzero(heights.labels)
    places = heights.xy_m(rows, columns)
    low, high = places.min(axis=0) - 0.03, places.max(axis=0) + 0.03
    x_m = max(high[0] - low[0], (high[1] - low[1]) / aspect)
    half = np.array([x_m, aspect * x_m]) / 2
    return (low + high) / 2 - half, (low + high) / 2 + half


def shaded(heights: HeightMap) -> Image:
    """(ny, nx, 3)."""
    shades = np.clip(heights.surface_m / heights.surface_m[heights.labels > 0].max() * 255, 0, 255)
    colors: Image = np.array(cv2.applyColorMap(shades.astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1])
    colors[heights.bound_m > heights.surface_m + 0.003] = HIDDEN_RGB
    return colors


# --- table ------------------------------------------------------------------------------------------------------------


def table_picture(one: Look) -> Image:
    """The grasp in the image, and from aside: the seen table, the station's, the fingers that follow the seen one."""
    assert one.found is not None
    image = crop(annotated(one.found, 0, ()), one.seen.labels > 0, 2 * MARGIN_PX)
    table = one.seen.table
    title = f"seen {table.offset_m * 1e3:+.1f} mm off, tilted by {np.degrees(table.tilt_rad):.1f} deg: along the slope"
    return row([titled("the grasp", image, HEIGHT_PX), titled(title, _side(one, one.found.grasps[0]), HEIGHT_PX)])


def _side(one: Look, grasp: Grasp) -> Image:
    """A slice through the grasp along the table's slope."""
    table, scene = one.scene.table, one.scene
    slope = np.array([table.slope_x, table.slope_y])
    along = slope / np.linalg.norm(slope)
    middle = grasp.base_from_tcp[:2, 3]
    off = scene.view.points_base[..., :2] - middle
    near = (np.abs(off @ np.array([-along[1], along[0]])) < _SLICE_M) & (np.abs(off @ along) < 0.2)
    s_m, z_m, number = (off @ along)[near], scene.view.points_base[..., 2][near], scene.labels[near]
    image = blank(760, 420)
    chart = Chart(image, (52, 30, 745, 375), x=(-200.0, 200.0), y=(-25.0, 115.0))
    for value in np.unique(number):
        rgb = FAINT if value == 0 else color_of(int(value))
        chart.points(s_m[number == value] * 1e3, z_m[number == value] * 1e3, rgb)
    ends = np.array([-0.2, 0.2])
    level_m = table.height_m + middle @ slope + ends * np.linalg.norm(slope)
    chart.curve(ends * 1e3, np.full(2, one.station.scene.table.top_m * 1e3), STATION_RGB)
    chart.curve(ends * 1e3, level_m * 1e3, SEEN_RGB)
    hand = hand_outline(grasp)
    chart.curve((hand[:, :2] - middle) @ along * 1e3, hand[:, 2] * 1e3, HAND_RGB)
    chart.axes("along the slope [mm]", "z of base [mm]")
    names = {"the station's table": STATION_RGB, "the table as seen": SEEN_RGB, "the opened hand": HAND_RGB}
    chart.legend(names, (250, 22))
    return image


def hand_outline(grasp: Grasp) -> Array:
    """Both fingers and the palm of the opened hand as one line (n, 3) [m] in ``base``."""
    half, tip, palm = grasp.opening_m / 2, FINGER_TIP_M, FINGER_TIP_M - FINGER_LENGTH_M
    corners = np.array([(0, -half, tip), (0, -half, palm), (0, half, palm), (0, half, tip)])
    return apply(grasp.base_from_tcp, corners)


# --- refusals ---------------------------------------------------------------------------------------------------------


def _refusal(one: Look) -> Image:
    assert one.failure is not None
    shown = (one.seen.labels > 0) | one.seen.unseen
    image = crop(draw_scene(one.color, one.seen), shown, 2 * MARGIN_PX)
    return titled(one.failure.failure.value, image, HEIGHT_PX, one.failure.text)


if __name__ == "__main__":
    main()
