"""One labelled image of a grasp dataset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from bus.errors import ConfigError
from bus.messages import Rectangle

Half = Literal["development", "report"]


@dataclass(frozen=True)
class Sample:
    """An image and the rectangles that count as right.

    Attributes:
        color: (H, W, 3) RGB.
        depth_m: (H, W), NaN = unknown; None = the sample has none. Not always z-depth: see the dataset.
        mask: (H, W) of the object, where the dataset gives it.
        half: what may be tuned on it, or only reported; whole objects belong to one of the two.
    """

    name: str
    color: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32] | None
    mask: npt.NDArray[np.bool_] | None
    truths: tuple[Rectangle, ...]
    half: Half


def halves(images: Sequence[int]) -> list[Half]:
    """The half of each object, given its number of images: the one that has fewer so far, so both get as many."""
    so_far: dict[Half, int] = {"development": 0, "report": 0}
    chosen: list[Half] = []
    for count in images:
        half: Half = "development" if so_far["development"] <= so_far["report"] else "report"
        so_far[half] += count
        chosen.append(half)
    return chosen


def read_image(path: Path, flags: int = cv2.IMREAD_UNCHANGED) -> npt.NDArray[np.generic]:
    """A picture or depth image, by default as it is stored. Raises: ConfigError when it cannot be read."""
    image = cv2.imread(str(path), flags)
    if image is None:
        raise ConfigError(f"Cannot read the image {path}.", "Is the dataset whole?")
    return np.asarray(image)


def read_color(path: Path) -> npt.NDArray[np.uint8]:
    """(H, W, 3) RGB, of grey pictures too. Raises: ConfigError."""
    return np.asarray(read_image(path, cv2.IMREAD_COLOR_RGB), dtype=np.uint8)


def read_depth(path: Path) -> npt.NDArray[np.float32]:
    """(H, W) [m]; what is not positive is unknown (NaN)."""
    depth_m = read_image(path).astype(np.float32)
    return np.where(depth_m > 0, depth_m, np.float32(np.nan))


def require_folder(root: Path, *parts: str) -> None:
    """Raises: ConfigError when ``root`` lacks one of the folders."""
    for part in ("", *parts):
        if not (root / part).is_dir():
            raise ConfigError(f"There is no folder {root / part}.", "Name the dataset's folder with --root.")
