"""Rows of titled pictures for the pages of docs/."""

from __future__ import annotations

import textwrap
from pathlib import Path

import cv2
import numpy as np

from docs.chart import INK, Image, blank

GAP_PX, _HEAD_PX, _LINE_PX, _TEXT = 8, 26, 17, 0.42
STRIP_TITLE_SCALE = 1.8
_LETTER_PX = 6.2
"""About the width of a letter: text is broken where it would leave its tile."""


def titled(title: str, tile: Image, height_px: int, text: str = "", title_scale: float = 1.0) -> Image:
    """The picture (H, W, 3) at this height with its title above, ``title_scale`` times as large, and ``text`` below."""
    width_px = round(tile.shape[1] * height_px / tile.shape[0])
    head = blank(width_px, round(_HEAD_PX * title_scale))
    _write(head, title, round(18 * title_scale), title_scale)
    lines = textwrap.wrap(text, int(width_px / _LETTER_PX))
    foot = blank(width_px, _LINE_PX * len(lines))
    for number, line in enumerate(lines):
        _write(foot, line, 13 + number * _LINE_PX)
    return np.vstack([head, cv2.resize(tile, (width_px, height_px), interpolation=cv2.INTER_AREA), foot])


def row(tiles: list[Image]) -> Image:
    """The pictures beside each other, with gaps."""
    height_px = max(len(tile) for tile in tiles)
    parts: list[Image] = []
    for tile in tiles:
        whole = blank(tile.shape[1], height_px)
        whole[: len(tile)] = tile
        parts += [whole, blank(GAP_PX, height_px)]
    return np.hstack(parts[:-1])


def column(rows: list[Image]) -> Image:
    """The rows below each other."""
    width_px = max(one.shape[1] for one in rows)
    return np.vstack([np.hstack([one, blank(width_px - one.shape[1], len(one))]) for one in rows])


def save(image: Image, path: Path) -> None:
    """Write the picture as a JPEG."""
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


def strip(tiles: dict[str, Image], height_px: int) -> Image:
    """Pictures beside each other, with titles that can be read where a page shows the whole at half its size."""
    return row([titled(title, tile, height_px, title_scale=STRIP_TITLE_SCALE) for title, tile in tiles.items()])


def _write(image: Image, text: str, bottom_px: int, scale: float = 1.0) -> None:
    cv2.putText(image, text, (6, bottom_px), cv2.FONT_HERSHEY_SIMPLEX, _TEXT * scale, INK, 1, cv2.LINE_AA)
