"""A picture that a notebook shows, and that can be saved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from bus.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture; a notebook shows it where it is the last value of a cell.

    Attributes:
        rgb: (H, W, 3) uint8, RGB.
    """

    rgb: npt.NDArray[np.uint8]

    def save(self, path: str | Path) -> Path:
        """Write the picture as a file, by the name's ending (``.png``, ``.jpg``), and return its path.

        Raises: ConfigError when the file cannot be written.
        """
        try:
            if cv2.imwrite(str(path), self._bgr):
                return Path(path)
        except cv2.error as error:
            raise ConfigError(f"{path} is of no kind of picture.", "Name a .png or a .jpg.") from error
        raise ConfigError(f"{path} cannot be written.", "Does its folder exist?")

    def scaled(self, width_px: int) -> Picture:
        """Return the picture, ``width_px`` wide. Raises: ConfigError for less than one pixel."""
        if width_px < 1:
            raise ConfigError(f"width_px is {width_px}.", "A picture is at least one pixel wide.")
        height_px = max(1, round(self.rgb.shape[0] * width_px / self.rgb.shape[1]))
        return Picture(np.asarray(cv2.resize(self.rgb, (width_px, height_px), interpolation=cv2.INTER_AREA)))

    @property
    def _bgr(self) -> npt.NDArray[np.uint8]:
        return np.ascontiguousarray(self.rgb[..., ::-1])

    def _repr_png_(self) -> bytes:
        """The picture as PNG: how IPython asks for it."""
        return cv2.imencode(".png", self._bgr)[1].tobytes()

    def __repr__(self) -> str:
        return f"Picture({self.rgb.shape[1]} x {self.rgb.shape[0]} px)"
