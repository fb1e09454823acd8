"""Draws the figures of docs/method.md from a recording made with a hosted model.

``uv run python -m docs.method_pictures FILE.mcap``
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import Detections
from config.load import station_from
from logs.mcap.reader import read_cycle
from logs.report.evidence import choice
from logs.report.images import annotated
from perception.geometry.depth import Rgbd, register
from perception.geometry.lift import project
from perception.geometry.window import Window, decode_picture
from perception.goal.imagine import observed_object_of
from perception.scene.segment import segment

TILE_PX = 300
FOLDER = Path(__file__).parent / "method"

Image = npt.NDArray[np.uint8]


def main(recording: Path) -> None:
    record = read_cycle(recording)
    found, observation = record.stages["detect"].result, record.observation
    assert isinstance(found, Detections) and observation is not None
    station = station_from(dict(record.station))
    evidence, base_from_color = found.evidence, observation.view.base_from_color
    rgbd = register(observation.frame)
    scene = segment(rgbd, base_from_color, station)[0]
    window = Window.around(scene.object_mask)
    subject = observed_object_of(rgbd, scene, base_from_color)
    drawn = decode_picture(record.replies[-1].image_png or b"", window)
    observed, imagined = (_overlay(rgbd.color, points, rgbd, window) for points in (
        evidence.goal_points, evidence.aligned_points))  # fmt: skip
    masks = np.zeros_like(rgbd.color)
    masks[evidence.goal_object_mask], masks[evidence.goal_rod_mask] = (120, 150, 190), (230, 60, 190)
    FOLDER.mkdir(exist_ok=True)
    _write("imagine.jpg", {
        "observed": window.cut(rgbd.color, 0),
        "what the model is shown": window.cut(subject.masked, subject.background),
        "what it drew": drawn,
        "rod and object in it": window.cut(masks, 0),
    })  # fmt: skip
    _write("carry.jpg", {
        "imagined object (blue) where it was drawn": observed,
        "the same, carried back": imagined,
        "the rod's runs as rectangles": window.cut(annotated(found, *choice(record, found)), 0),
    })  # fmt: skip


def _overlay(color: Image, points: npt.NDArray[np.float32], rgbd: Rgbd, window: Window) -> Image:
    image = np.ascontiguousarray(color // 2 + 60)
    for u, v in np.rint(project(points.astype(float), rgbd.camera)).astype(int)[::2]:
        cv2.circle(image, (int(u), int(v)), 1, (40, 90, 255), -1)
    return window.cut(image, 0)


def _write(name: str, tiles: dict[str, Image]) -> None:
    row = []
    for title, tile in tiles.items():
        big = cv2.resize(tile, (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA)
        head = np.full((26, TILE_PX, 3), 255, np.uint8)
        cv2.putText(head, title, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (40, 40, 40), 1, cv2.LINE_AA)
        row += [np.vstack([head, big]), np.full((TILE_PX + 26, 8, 3), 255, np.uint8)]
    cv2.imwrite(str(FOLDER / name), np.hstack(row[:-1])[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
