"""Draws the pictures of several looks in docs/method.md: ``uv run python -m docs.look_pictures``.

The scenes are dropped and photographed by `benchmarks.heaps`, also from the places that the arm would look from; drawn
is what the product made of the first look alone, and of all three.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

os.environ.setdefault("MUJOCO_GL", "egl")  # headless; MuJoCo reads it when it is first imported

from benchmarks.heaps.heap import make
from benchmarks.heaps.plan import HEAPS, TALL
from benchmarks.heaps.shapes import Shape
from benchmarks.heaps.views import render
from bus.errors import CycleFailure
from bus.messages import Observation, ObservedScene
from bus.transforms import apply
from config.schema import Station
from docs.chart import Array, Chart, Image, Rgb, blank
from docs.heap_shapes import HEAP
from docs.scene_pictures import HAND_RGB, HEIGHT_PX, hand_outline, shaded, things_m
from docs.tiles import column, row, save, titled
from logs.report.images import crop
from logs.scene_picture import draw_scene
from perception.detector import detect, ignore_reply
from perception.fusion.agreed import agreed
from perception.models import open_models
from perception.scene.heightmap import CELL_M
from perception.scene.look import Look
from perception.scene.scene import Scene, scene_of

FOLDER = Path(__file__).parent / "method"
HEAP_SEED, BOTTLE_SEED = 2, 13
"""Of a heap in a bin, and of a bottle of the set ``tall``."""
LOOK_RGB: tuple[Rgb, ...] = ((93, 107, 122), (224, 99, 45), (47, 111, 222))
_SHAPE_PX, _FILLED = (600, 420), 0.9
HEAP_FROM_DEG, BOTTLE_FROM_DEG = (215.0, 25.0), (-75.0, 30.0)
"""From where the clouds are drawn: azimuth and height over the horizon."""
_HIGH_M = 0.10


@dataclass(frozen=True)
class Cloud:
    """Points (n, 3) of the things in ``base`` [m], each with its colour (n, 3)."""

    points: Array
    rgb: Image


def main() -> None:
    """Draw both."""
    save(fused_picture(*_observed(HEAP, HEAP_SEED, HEAPS)), FOLDER / "looks.jpg")
    save(side_picture(*_observed((), BOTTLE_SEED, TALL)), FOLDER / "side.jpg")


def _observed(shapes: Sequence[Shape], seed: int, set_name: str) -> tuple[Station, tuple[Observation, ...]]:
    """The station of a scene, and its observations, the one from the capture pose first."""
    heap = make(max(1, len(shapes)), seed, shapes, set_name)
    return heap.station(), replace(heap, further=render(heap, shapes)).observations()


def _scene(station: Station, looks: Sequence[Observation]) -> Scene:
    return scene_of(agreed([Look.of(one, station) for one in looks], station)[0], station)


# --- one look beside three --------------------------------------------------------------------------------------------


def fused_picture(station: Station, looks: Sequence[Observation]) -> Image:
    """Above the height maps of one look and of three, below their points of the things, seen from aside."""
    one, all_looks = _scene(station, looks[:1]), _scene(station, looks)
    low, high = things_m(all_looks.heights, _SHAPE_PX[0] / _SHAPE_PX[1])
    maps, clouds = [], []
    for name, scene in (("one look", one), ("three looks", all_looks)):
        hidden = _hidden_share(scene, low, high)
        maps.append(titled(f"{name}: heights; dark, {hidden:.0%}: not seen", _heights(scene, low, high), HEIGHT_PX))
        points = _drawn(_by_height(scene), HEAP_FROM_DEG)
        clouds.append(titled(f"{name}: the points of the things, from aside", points, HEIGHT_PX))
    return column([row(maps), row(clouds)])


def _heights(scene: Scene, low: Array, high: Array) -> Image:
    """The height map from above, cells that may be occupied unseen dark; x up and y to the left, as in the image."""
    image, heights = blank(*_SHAPE_PX), scene.heights
    (x, y), (rows, columns) = heights.origin_m, heights.surface_m.shape
    chart = Chart(image, (0, 0, _SHAPE_PX[0] - 1, _SHAPE_PX[1] - 1), x=(high[1], low[1]), y=(low[0], high[0]))
    chart.cells(shaded(heights), (y, y + rows * CELL_M), (x, x + columns * CELL_M))
    return image


def _hidden_share(scene: Scene, low: Array, high: Array) -> float:
    """Share of the cells inside the drawn part that may be occupied, though nothing was seen in them."""
    rows, columns = np.indices(scene.heights.surface_m.shape)
    places = scene.heights.xy_m(rows.ravel(), columns.ravel())
    inside = ((places >= low) & (places <= high)).all(axis=1)
    hidden = (scene.heights.bound_m > scene.heights.surface_m + 0.003).ravel()
    return float(hidden[inside].mean())


def _by_height(scene: Scene) -> Cloud:
    """The things' points, coloured by their height over the table."""
    points = np.concatenate([look.view.points_base[labels > 0] for look, labels in _each(scene)])
    height_m = apply(scene.table.table_from_base, points.astype(float))[:, 2]
    shades = np.clip(255 * height_m / _HIGH_M, 0, 255).astype(np.uint8)
    return Cloud(points.astype(float), np.array(cv2.applyColorMap(shades[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]))


def _by_look(scene: Scene) -> Cloud:
    """The things' points, those of each look in its tint."""
    parts = [look.view.points_base[labels > 0] for look, labels in _each(scene)]
    tints = np.repeat(np.array(LOOK_RGB[: len(parts)], dtype=np.uint8), [len(part) for part in parts], axis=0)
    return Cloud(np.concatenate(parts).astype(float), tints)


def _each(scene: Scene) -> list[tuple[Look, np.ndarray]]:
    return list(zip(scene.looks, scene.look_labels, strict=True))


def _drawn(cloud: Cloud, from_deg: tuple[float, float], line: Array | None = None) -> Image:
    """The points without perspective, nearer ones over farther ones and brighter; a line (n, 3) over them."""
    axes = _axes(*from_deg)
    flat = np.concatenate([cloud.points, np.zeros((0, 3)) if line is None else line]) @ axes
    low, high = flat[:, :2].min(axis=0), flat[:, :2].max(axis=0)
    scale = min(_FILLED * np.array(_SHAPE_PX) / (high - low))
    pixels = np.array(_SHAPE_PX) / 2 + scale * (flat[:, :2] - (low + high) / 2) * [1.0, -1.0]
    at, near = np.rint(pixels).astype(np.int32), flat[: len(cloud.points), 2]
    shade = 0.6 + 0.4 * (near - near.min()) / np.ptp(near)
    rgb, image = (cloud.rgb * shade[:, None]).astype(int), blank(*_SHAPE_PX)
    for index in np.argsort(near, kind="stable"):
        cv2.circle(image, at[index].tolist(), 2, rgb[index].tolist(), -1, cv2.LINE_AA)
    cv2.polylines(image, [at[len(near) :]], False, HAND_RGB, 3, cv2.LINE_AA)
    return image


def _axes(azimuth_deg: float, height_deg: float) -> Array:
    """(3, 3) as columns: right and up in the drawing, and towards who looks; in ``base``."""
    turn, raised = np.radians([azimuth_deg, height_deg])
    near = np.array([np.cos(turn) * np.cos(raised), np.sin(turn) * np.cos(raised), np.sin(raised)])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    return np.column_stack([right, np.cross(near, right), near])


# --- from the side ----------------------------------------------------------------------------------------------------


def side_picture(station: Station, looks: Sequence[Observation]) -> Image:
    """A bottle from above, where there is no grasp; and with three looks: the last one, and the grasp."""
    first, why = _refused(station, looks[0])
    found = detect(looks[0], station, open_models(station, {}), ignore_reply, others=looks[1:])
    scene = _scene(station, looks)
    labels = found.scene.look_labels[-1]
    last = found.scene.model_copy(update={"labels": labels, "unseen": np.zeros_like(labels, dtype=bool)})
    image = draw_scene(scene.looks[-1].rgbd.color, last)
    grasp = found.grasps[0]
    hand = _with_arm(hand_outline(grasp), grasp.base_from_tcp)
    tilt_deg = np.degrees(np.arccos(-grasp.base_from_tcp[2, 2]))
    title = f"three looks, each in its tint: a grasp {tilt_deg:.0f} deg aside"
    return row([
        titled("one look", first, HEIGHT_PX, why),
        titled("the third look", crop(image, labels > 0, 70), HEIGHT_PX),
        titled(title, _drawn(_by_look(scene), BOTTLE_FROM_DEG, hand), HEIGHT_PX),
    ])  # fmt: skip


def _refused(station: Station, look: Observation) -> tuple[Image, str]:
    """Return what one look shows of the thing, and why it is refused."""
    scenes = list[ObservedScene]()
    try:
        detect(look, station, open_models(station, {}), ignore_reply, on_scene=scenes.append)
    except CycleFailure as failure:
        seen = scenes[0]
        shown = (seen.labels > 0) | seen.unseen
        image = draw_scene(Look.of(look, station).rgbd.color, seen)
        return crop(image, shown, 60), f"{failure.failure.value}: {failure.text}"
    raise AssertionError("One look is enough for this scene: choose another.")


def _with_arm(outline: Array, base_from_tcp: Array) -> Array:
    """The hand's outline (n, 3) with a piece of the arm behind its palm."""
    half = len(outline) // 2
    palm = outline[half - 1 : half + 1].mean(axis=0)
    behind = palm - 0.06 * base_from_tcp[:3, 2]
    return np.concatenate([outline[:half], [palm, behind, palm], outline[half:]])


if __name__ == "__main__":
    main()
