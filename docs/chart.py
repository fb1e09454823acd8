"""Charts for the pictures of docs/, drawn into an image: axes, curves, a map of cells."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Array = npt.NDArray[np.floating]
Rgb = tuple[int, int, int]
Range = tuple[float, float]

INK, FAINT = (40, 40, 40), (170, 178, 186)
_TEXT = 0.42
_SHIFT = 4
"""OpenCV's coordinates are integers of 1/16 pixel."""
_TICK_PX, _TICKS = 4, 6
_DOT_EVERY_PX = 6.0


def blank(width_px: int, height_px: int) -> Image:
    """A white image (H, W, 3)."""
    return np.full((height_px, width_px, 3), 255, dtype=np.uint8)


class Chart:
    """Axes in a part of an RGB image, and what is drawn inside them.

    Args:
        image: (H, W, 3), drawn on.
        box_px: left, top, right and bottom of the axes' frame.
        x, y: what the axes reach from (left, bottom) and to (right, top); an axis may run backwards.
    """

    def __init__(self, image: Image, box_px: tuple[int, int, int, int], x: Range, y: Range) -> None:
        self._image, self._box_px, self._x, self._y = image, box_px, x, y
        left, top, right, bottom = box_px
        self._inside = image[top:bottom, left:right]  # the same pixels: what is drawn here is cut off at the frame

    def axes(self, x_name: str = "", y_name: str = "", *, y_right: bool = False) -> None:
        """The frame, its ticks with their values, and the names: of y above the frame, of x below. "" = no ticks."""
        left, top, right, bottom = self._box_px
        cv2.rectangle(self._image, (left, top), (right, bottom), INK, 1)
        for value in _ticks(self._x) if x_name else ():
            u = left + round(self._pixels(value, self._y[0])[0, 0])
            cv2.line(self._image, (u, bottom), (u, bottom + _TICK_PX), INK, 1)
            self.words(f"{value:g}", (u, bottom + 18), align=0.5)
        for value in _ticks(self._y):
            v = top + round(self._pixels(self._x[0], value)[0, 1])
            u, out = (right, _TICK_PX) if y_right else (left, -_TICK_PX)
            cv2.line(self._image, (u, v), (u + out, v), INK, 1)
            self.words(f"{value:g}", (u + 2 * out, v + 4), align=0.0 if y_right else 1.0)
        self.words(x_name, ((left + right) // 2, bottom + 36), align=0.5)
        self.words(y_name, (right if y_right else left, top - 8), align=1.0 if y_right else 0.0)

    def words(self, text: str, at_px: tuple[int, int], rgb: Rgb = INK, align: float = 0.0) -> int:
        """Text at ``at_px``, which is its left end (``align`` 0), middle (0.5) or right end (1); its width [px]."""
        width_px = int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _TEXT, 1)[0][0])
        start = (round(at_px[0] - align * width_px), at_px[1])
        cv2.putText(self._image, text, start, cv2.FONT_HERSHEY_SIMPLEX, _TEXT, rgb, 1, cv2.LINE_AA)
        return width_px

    def legend(self, entries: dict[str, Rgb], at_px: tuple[int, int]) -> None:
        """Each name beside a dash of its colour, in one line from ``at_px``."""
        u, v = at_px
        for name, rgb in entries.items():
            cv2.line(self._image, (u, v - 4), (u + 16, v - 4), rgb, 2, cv2.LINE_AA)
            u += 44 + self.words(name, (u + 22, v))

    def curve(self, x: Array | float, y: Array | float, rgb: Rgb) -> None:
        """A line through the points (n,)."""
        line = np.rint(self._pixels(x, y) * 2**_SHIFT).astype(np.int32)
        cv2.polylines(self._inside, [line], False, rgb, 1, cv2.LINE_AA, _SHIFT)

    def dotted(self, x: Array, y: Array, rgb: Rgb) -> None:
        """The same as a row of dots, evenly spaced on the picture."""
        line = self._pixels(x, y)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        at = np.arange(0.0, along[-1], _DOT_EVERY_PX)
        self._dots(np.stack([np.interp(at, along, line[:, axis]) for axis in (0, 1)], axis=-1), rgb)

    def points(self, x: Array, y: Array, rgb: Rgb) -> None:
        """A dot at each point (n,)."""
        self._dots(self._pixels(x, y), rgb)

    def cells(self, colors: Image, x: Range, y: Range) -> None:
        """A map: ``colors`` (n, m, 3) of equal cells that fill ``x`` (n of them) and ``y`` (m); the rest stays."""
        height_px, width_px = self._inside.shape[:2]
        u, v = np.meshgrid(np.arange(width_px), np.arange(height_px))
        across = self._x[0] + (u + 0.5) / width_px * (self._x[1] - self._x[0])
        up = self._y[1] - (v + 0.5) / height_px * (self._y[1] - self._y[0])
        n = np.floor((across - x[0]) / (x[1] - x[0]) * colors.shape[0]).astype(int)
        m = np.floor((up - y[0]) / (y[1] - y[0]) * colors.shape[1]).astype(int)
        there = (n >= 0) & (n < colors.shape[0]) & (m >= 0) & (m < colors.shape[1])
        self._inside[there] = colors[n[there], m[there]]

    def _pixels(self, x: Array | float, y: Array | float) -> Array:
        """(n, 2) pixels from the frame's corner of values (n,); a single value goes with each of the others."""
        height_px, width_px = self._inside.shape[:2]
        u = (np.atleast_1d(x) - self._x[0]) / (self._x[1] - self._x[0]) * width_px
        v = (self._y[1] - np.atleast_1d(y)) / (self._y[1] - self._y[0]) * height_px
        return np.stack(np.broadcast_arrays(u, v), axis=-1)

    def _dots(self, pixels: Array, rgb: Rgb) -> None:
        for u, v in np.rint(pixels * 2**_SHIFT).astype(int):
            cv2.circle(self._inside, (int(u), int(v)), round(1.2 * 2**_SHIFT), rgb, -1, cv2.LINE_AA, _SHIFT)


def _ticks(ends: Range) -> list[float]:
    """Round values between ``ends``, about ``_TICKS`` of them."""
    low, high = min(ends), max(ends)
    power = 10.0 ** np.floor(np.log10((high - low) / _TICKS))
    step = next(step for step in (1, 2, 5, 10) if (high - low) / (step * power) <= _TICKS) * power
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    return [round(float(n * step), 9) + 0.0 for n in np.arange(first, last + 1)]
