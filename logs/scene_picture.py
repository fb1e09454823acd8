"""Draws what detect saw: every thing in its colour and with its number, and, hatched, what was not seen.

Images are the undistorted colour image; for report pages and the live view.
"""

from __future__ import annotations

import colorsys

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import find_objects

from bus.arrays import LabelImage, Mask
from bus.messages import ObservedScene

_TURN = 0.61803
"""Successive numbers lie a golden section apart on the colour circle: neighbours never look alike."""
_FILLED, _STRIPED = 0.40, 0.75
"""Shares of the drawn colour in a pixel."""
_DARK_RGB, _LIGHT_RGB = (27, 34, 44), (250, 250, 250)
_SPECK_PX = 3
"""Narrower holes and specks are depth noise at edges: they are neither hatched nor outlined."""
_LEAST_SHADED_PX, _COARSE_PX = 64.0, 1.5
"""Of the rims of what was not seen: the least area [px^2], and how far they may lie from the true ones [px]."""

Image = npt.NDArray[np.uint8]
Rgb = tuple[int, int, int]


def color_of(number: int) -> Rgb:
    """Return the colour of the thing with this number, from 1 on."""
    red, green, blue = colorsys.hsv_to_rgb((0.58 + (number - 1) * _TURN) % 1.0, 0.85, 0.95)
    return round(255 * red), round(255 * green), round(255 * blue)


def draw_scene(color: Image, scene: ObservedScene, region_px: npt.NDArray[np.float64] | None = None) -> Image:
    """A copy of the image (H, W, 3) with the things and what was not seen.

    Args:
        region_px: (n, 2) the outline of the pick region; None = not drawn.
    """
    image = np.array(color)
    _hatch(image, scene.unseen & (scene.labels == 0))
    unit = max(1, round(image.shape[1] / 640))
    if region_px is not None:
        cv2.polylines(image, [np.rint(region_px).astype(np.int32)], True, _LIGHT_RGB, unit, cv2.LINE_AA)
    windows = _windows(scene.labels)
    for number in (one.number for one in scene.instances if one.number in windows):
        top, left, mask = windows[number]
        part = image[top : top + mask.shape[0], left : left + mask.shape[1]]
        part[mask] = _mixed(part[mask], color_of(number), _FILLED)
        outlines = [outline + np.array([left, top], np.int32) for outline in outlines_px(mask)]
        cv2.polylines(image, outlines, True, color_of(number), unit, cv2.LINE_AA)
    for number, place in places_px(scene.labels, [one.number for one in scene.instances]).items():
        _write_number(image, number, place, unit)
    return image


def places_px(labels: LabelImage, numbers: list[int]) -> dict[int, tuple[int, int]]:
    """Return where (u, v) each thing's number stands: deepest inside of it. Things without a pixel have none."""
    places, windows = {}, _windows(labels)
    for number in numbers:
        if number in windows:
            top, left, mask = windows[number]
            inside = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 3)
            row, column = np.unravel_index(int(inside.argmax()), inside.shape)
            places[number] = (left + int(column) - 1, top + int(row) - 1)
    return places


def _windows(labels: LabelImage) -> dict[int, tuple[int, int, Mask]]:
    """Of each thing the first row and column of the window that holds it, and its mask (h, w) there."""
    found = {}
    for number, window in enumerate(find_objects(labels.astype(np.int32)), start=1):
        if window is not None:
            rows, columns = window
            found[number] = (rows.start, columns.start, labels[window] == number)
    return found


def outlines_px(mask: Mask) -> list[npt.NDArray[np.int32]]:
    """Return the outlines (k, 2) of a mask (H, W), without those of its specks."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [contour.reshape(-1, 2) for contour in contours if cv2.contourArea(contour) >= _SPECK_PX**2]


def unseen_px(scene: ObservedScene) -> list[npt.NDArray[np.int32]]:
    """Return the rims (k, 2) of what was not seen, outer ones and those of holes in it: even-odd filling shades it."""
    mask = _without_specks(scene.unseen & (scene.labels == 0))
    rims, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    large = [rim for rim in rims if cv2.contourArea(rim) >= _LEAST_SHADED_PX]
    coarse = (cv2.approxPolyDP(rim, _COARSE_PX, True).reshape(-1, 2) for rim in large)
    return [rim for rim in coarse if len(rim) > 2]


def _without_specks(mask: Mask) -> npt.NDArray[np.uint8]:
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((_SPECK_PX, _SPECK_PX), np.uint8))
    return np.asarray(opened, dtype=np.uint8)


def _hatch(image: Image, mask: Mask) -> None:
    """Draw dark and light stripes over the mask (H, W)."""
    holes = _without_specks(mask) > 0
    rows, columns = np.nonzero(holes)
    width_px = max(3, round(image.shape[1] / 240))
    stripe = (rows + columns) // width_px % 3
    for phase, rgb in ((0, _DARK_RGB), (1, _LIGHT_RGB)):
        at = rows[stripe == phase], columns[stripe == phase]
        image[at] = _mixed(image[at], rgb, _STRIPED)


def _mixed(pixels: Image, rgb: Rgb, share: float) -> Image:
    """Pixels (n, 3) with a share of another colour."""
    return np.asarray(pixels * (1 - share) + np.array(rgb) * share, dtype=np.uint8)


def _write_number(image: Image, number: int, place: tuple[int, int], unit: int) -> None:
    """Write the number around a place (u, v), light with a dark rim."""
    text, scale = str(number), 0.45 * unit
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, unit)
    left, bottom = place[0] - width // 2, place[1] + height // 2
    rim = [(right, down) for right in (-unit, 0, unit) for down in (-unit, 0, unit)]
    for (right, down), rgb in [*((off, _DARK_RGB) for off in rim), ((0, 0), _LIGHT_RGB)]:
        corner = left + right, bottom + down
        cv2.putText(image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, rgb, unit, cv2.LINE_AA)
