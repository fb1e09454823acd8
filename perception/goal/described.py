"""Things in words, and the things that words ask for, without a model (`config.words`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import Instance
from bus.transforms import apply, inverse
from config.words import COLORS, Wanted
from perception.scene.scene import Scene

_HUES_DEG = ((15, "red"), (40, "orange"), (70, "yellow"), (165, "green"), (200, "cyan"), (255, "blue"), (320, "purple"),
             (345, "pink"), (361, "red"))  # fmt: skip
"""Up to which hue of the HSV circle a colour goes."""
_PALE, _DARK, _BRIGHT = 0.22, 0.22, 0.75
"""Below this saturation a colour is black, grey or white; below this value it is black; above this, white."""
_BROWN_BELOW = 0.6
"""Orange of a lower value is brown."""
_ITS_COLOR = 0.3
"""A thing has a colour when this share of it has."""


def colors_of(pixels: npt.NDArray[np.uint8]) -> tuple[str, ...]:
    """Return the colours of the pixels (n, 3) of a thing, the most frequent first; none where there are none."""
    if not len(pixels):
        return ()
    share = np.bincount(_color_indices(pixels), minlength=len(COLORS)) / len(pixels)
    order = np.argsort(-share, kind="stable")
    return tuple(COLORS[index] for position, index in enumerate(order) if share[index] >= _ITS_COLOR or position == 0)


def in_words(pixels: npt.NDArray[np.uint8], instance: Instance) -> str:
    """A thing for a person: the colour of its pixels (n, 3), its size and place."""
    length_mm, width_mm, height_mm = (instance.size_m * 1e3).round().astype(int)
    x, y, _ = instance.top_m
    color = "-".join(colors_of(pixels)) or "unseen colour"
    return f"{color} {length_mm} x {width_mm} x {height_mm} mm at ({x:.2f}, {y:.2f})"


def all_in_words(scene: Scene, instances: Sequence[Instance]) -> str:
    """Every thing that was seen, for the reason of a target that was not found."""
    if not instances:
        return "Nothing was seen."
    return f"Seen: {'; '.join(in_words(pixels_of(scene, one.number), one) for one in instances)}."


def pixels_of(scene: Scene, number: int) -> npt.NDArray[np.uint8]:
    """Return the pixels (n, 3) of a thing in the look that is shown; none where it is not in that look."""
    return np.asarray(scene.rgbd.color[scene.color_labels == number])


def wanted_of(scene: Scene, instances: Sequence[Instance], wanted: Wanted, ranked: Sequence[int]) -> list[int]:
    """Return the numbers of the things that are asked for, best first: one where a superlative is asked for.

    Args:
        ranked: the numbers of all things, the one with the best grasp first.
    """
    kept = [one for one in instances if _has_color(scene, one, wanted.color) and _is_labelled(scene, one, wanted)]
    if wanted.superlative is not None and kept:
        kept = [max(kept, key=lambda one: _MEASURES[wanted.superlative or ""](scene, one))]
    numbers = {one.number for one in kept}
    return [number for number in ranked if number in numbers]


def _has_color(scene: Scene, instance: Instance, color: str | None) -> bool:
    return color is None or color in colors_of(pixels_of(scene, instance.number))


def _is_labelled(scene: Scene, instance: Instance, wanted: Wanted) -> bool:
    label = wanted.label
    if label is None:
        return True
    length_m, _, height_m = instance.size_m
    fits_length = label.length_m is None or label.length_m[0] <= length_m <= label.length_m[1]
    fits_height = label.height_m is None or label.height_m[0] <= height_m <= label.height_m[1]
    return fits_length and fits_height and _has_color(scene, instance, label.color)


def _color_indices(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.intp]:
    """The index in `COLORS` of each colour (n, 3)."""
    hue, saturation, value = cv2.cvtColor((rgb[None] / np.float32(255)).astype(np.float32), cv2.COLOR_RGB2HSV)[0].T
    names = np.array([COLORS.index(name) for _, name in _HUES_DEG])
    index = names[np.searchsorted([limit for limit, _ in _HUES_DEG], hue, side="right")]
    index[(index == COLORS.index("orange")) & (value < _BROWN_BELOW)] = COLORS.index("brown")
    pale = np.where(value > _BRIGHT, COLORS.index("white"), COLORS.index("grey"))
    index = np.where(saturation < _PALE, pale, index)
    return np.where(value < _DARK, COLORS.index("black"), index)


def _middle_u(scene: Scene, instance: Instance) -> float:
    """Column of a thing's top in the colour image, continued beyond its border."""
    x, _, z = apply(inverse(scene.base_from_color), np.asarray(instance.top_m)[None])[0]
    return float(x / z)


def _away_m(_scene: Scene, instance: Instance) -> float:
    return float(np.hypot(*instance.top_m[:2]))


_MEASURES: dict[str, Callable[[Scene, Instance], float]] = {
    "largest": lambda _, one: float(np.prod(one.size_m)),
    "smallest": lambda _, one: -float(np.prod(one.size_m)),
    "tallest": lambda _, one: float(one.size_m[2]),
    "flattest": lambda _, one: -float(one.size_m[2]),
    "highest": lambda _, one: float(one.top_m[2]),
    "longest": lambda _, one: float(one.size_m[0]),
    "shortest": lambda _, one: -float(one.size_m[0]),
    "leftmost": lambda scene, one: -_middle_u(scene, one),
    "rightmost": _middle_u,
    "nearest": lambda scene, one: -_away_m(scene, one),
    "farthest": _away_m,
}
"""The measure that is greatest of the thing that a superlative means."""
