"""Draws the figures of docs/method.md: of a recording made with a hosted model, and of scenes of its own.

``uv run python -m docs.method_pictures FILE.mcap``; the scenes alone: ``uv run python -m docs.scene_pictures``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import Detections
from config.load import station_from
from docs import scene_pictures
from docs.chart import Image
from docs.tiles import row, save, titled
from logs.mcap.reader import read_cycle
from logs.report.evidence import choice
from logs.report.images import annotated
from perception.geometry.depth import Rgbd
from perception.geometry.lift import project
from perception.geometry.window import Window, decode_picture
from perception.goal.imagine import observed_object_of
from perception.scene.scene import observe

TILE_PX = 300
FOLDER = Path(__file__).parent / "method"


def main(recording: Path) -> None:
    """Draw all of them."""
    hosted(recording)
    scene_pictures.main()


def hosted(recording: Path) -> None:
    """The steps of one pick: what was shown and drawn, and how it was carried back."""
    record = read_cycle(recording)
    found, observation = record.stages["detect"].result, record.observation
    assert isinstance(found, Detections) and observation is not None
    station = station_from(dict(record.station))
    evidence, scene = found.evidence, observe(observation, station)
    number = found.grasps[0].instance
    subject, _ = observed_object_of(scene, found.scene.instances, number, evidence.object_mask)
    window, in_crop = Window.around(evidence.object_mask), Window.around(subject.mask)
    drawn = decode_picture(record.replies[-1].image_png or b"", in_crop, subject.background)
    masks = np.zeros_like(scene.rgbd.color)
    masks[evidence.goal_object_mask], masks[evidence.goal_rod_mask] = (120, 150, 190), (230, 60, 190)
    _write("imagine.jpg", {
        "observed": window.cut(scene.rgbd.color, 0),
        "what the model is shown": in_crop.cut(subject.masked, subject.background),
        "what it drew": drawn,
        "rod and object in it": window.cut(masks, 0),
    })  # fmt: skip
    lifted, carried = (
        window.cut(_overlay(scene.rgbd, points), 0) for points in (evidence.goal_points, evidence.aligned_points)
    )
    _write("carry.jpg", {
        "imagined object (blue) where it was drawn": lifted,
        "the same, carried back": carried,
        "the rod's runs as rectangles": window.cut(annotated(found, *choice(record, found)), 0),
    })  # fmt: skip


def _overlay(rgbd: Rgbd, points: npt.NDArray[np.float32]) -> Image:
    image = np.ascontiguousarray(rgbd.color // 2 + 60)
    for u, v in np.rint(project(points.astype(float), rgbd.camera)).astype(int)[::2]:
        cv2.circle(image, (int(u), int(v)), 1, (40, 90, 255), -1)
    return image


def _write(name: str, tiles: dict[str, Image]) -> None:
    save(row([titled(title, tile, TILE_PX) for title, tile in tiles.items()]), FOLDER / name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
