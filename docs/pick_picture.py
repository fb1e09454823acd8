"""Draws docs/pick.jpg, the README's picture, from a recording: ``uv run python -m docs.pick_picture FILE.mcap``."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from bus.messages import Detections, PickPlan
from config.load import station_from
from docs.chart import INK, Image, blank
from docs.planning_pictures import motions
from logs.mcap.reader import read_cycle
from logs.report.evidence import choice
from logs.report.images import annotated
from perception.geometry.window import Window
from planning.robot import Robot

PICTURE = Path(__file__).with_name("pick.jpg")
HEIGHT_PX, GAP_PX, TITLE_PX = 240, 8, 24


def main(recording: Path) -> None:
    record = read_cycle(recording)
    found, plan = record.stages["detect"].result, record.stages["plan"].result
    assert isinstance(found, Detections) and isinstance(plan, PickPlan) and record.after is not None
    station = station_from(dict(record.station))
    window = Window.around(found.evidence.object_mask)
    tiles = {
        "what it sees": window.cut(found.evidence.color, 0),
        "what it imagines": window.cut(found.evidence.goal_image, 255),
        "where it grasps": window.cut(annotated(found, *choice(record, found)), 0),
        "how it moves": motions(plan, Robot(station), station),
        "what it holds": record.after.frame.color,
    }
    row = [_titled(title, tile) for title, tile in tiles.items()]
    gap = blank(GAP_PX, HEIGHT_PX + TITLE_PX)
    strip = np.hstack([part for tile in row for part in (tile, gap)][:-1])
    cv2.imwrite(str(PICTURE), strip[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


def _titled(title: str, tile: Image) -> Image:
    """The tile at the strip's height, with its title above."""
    width_px = round(tile.shape[1] * HEIGHT_PX / tile.shape[0])
    head = blank(width_px, TITLE_PX)
    cv2.putText(head, title, (4, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)
    return np.vstack([head, cv2.resize(tile, (width_px, HEIGHT_PX), interpolation=cv2.INTER_AREA)])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
