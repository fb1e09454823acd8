"""A contact sheet: many small images in one, for visual inspection."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt


def write_sheet(path: Path, tiles: Sequence[npt.NDArray[Any]], columns: int) -> None:
    """Write BGR tiles of one size, row by row; what is left of the last row is black."""
    padded = [*tiles, *[np.zeros_like(tiles[0])] * (-len(tiles) % columns)]
    rows = [np.hstack(padded[start : start + columns]) for start in range(0, len(padded), columns)]
    cv2.imwrite(str(path), np.vstack(rows))
