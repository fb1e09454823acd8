"""The embedded goal-image model: it takes the best axis of the whole-scene search, and paints the rod itself.

It needs no network and no training, and is deterministic. One instance works on one object at a time.
"""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.transforms import apply, inverse
from config.schema import Station
from perception.models.painter import paint
from perception.observed_object import Answer, ObservedObject

_STICK_OUT_M = 0.035
_AS_WRITTEN_M = 1e-4
"""The text has four decimals."""
_NUMBER = r"(-?\d+\.\d+)"
_AXIS = re.compile(rf"from \({_NUMBER}, {_NUMBER}, {_NUMBER}\) to \({_NUMBER}, {_NUMBER}, {_NUMBER}\)")

Array = npt.NDArray[np.float64]


class GeometricModel:
    """The axes along which the jaw could close on the object, and a shaded cylinder along the chosen one.

    Asked again about the same object in the same cycle, it proposes the next best axis.
    """

    name = "geometric"
    is_hosted = False
    _knows_run = True
    """Whether the axis ends at the contacts."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self.begin()

    def begin(self) -> None:
        """Begin a cycle; the proposals start from the best axis again."""
        self._asked: Counter[int] = Counter()  # a new one: a call that a stop left running may still count in the old

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        """Refuse any image (H, W, 3), because it understands no words. Raises: CycleFailure(TARGET_NOT_FOUND)."""
        text = "The embedded model reads no words."
        raise CycleFailure(Code.TARGET_NOT_FOUND, text)

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Return the best axis, as text. Raises: CycleFailure(NO_GRASP)."""
        number, axes = observed_object.instance.number, observed_object.axes
        proposed = self._asked[number]
        if len(axes) <= proposed:
            raise CycleFailure(Code.NO_GRASP, "No two opposite faces fit the jaw and can be reached from above.")
        self._asked[number] += 1
        chosen = axes[proposed]
        return Answer(
            f"The object is {observed_object.instance.size_m[2] * 1e3:.0f} mm high. Two opposite faces "
            f"{chosen.width_m * 1e3:.1f} mm apart fit the jaw; of {len(axes)} axes this is number {proposed + 1}, and "
            f"scores {chosen.score:.2f}. " + axis_in_words(*chosen.ends_base)
        )

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Return the axis as an editing instruction."""
        return Answer(f"Draw a straight cylinder {_axis_text(prompt)} (base frame, metres) through the object.")

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Paint the rod; parts behind the object stay hidden. Without an axis in the prompt it reasons first."""
        text = prompt if _AXIS.search(prompt) else self.reason(observed_object, prompt, cancel).text
        axis = _axis_text(text)
        run_base = np.array([float(value) for value in re.findall(_NUMBER, axis)]).reshape(2, 3)
        along = (run_base[1] - run_base[0]) / np.linalg.norm(run_base[1] - run_base[0])
        ends_base = run_base + np.outer([-_STICK_OUT_M, _STICK_OUT_M], along)
        run, ends = (apply(inverse(observed_object.base_from_color), points) for points in (run_base, ends_base))
        radius_m = self._station.perception.rod_radius_m
        approach = _approach_of(run_base, observed_object)
        goal = paint(observed_object, ends, radius_m, run if self._knows_run else None, approach)
        return Answer(f"rod {axis}", goal=goal)

    def close(self) -> None:
        """Do nothing; there are no resources."""


def _approach_of(run_base: Array, observed_object: ObservedObject) -> Array | None:
    """The approach (3,) of the axis that a run (2, 3) was read from; None when it is none of the object's."""
    for axis in observed_object.axes:
        if np.abs(axis.ends_base - run_base).max() < _AS_WRITTEN_M:
            return axis.approach_base
    return None


def axis_in_words(start_m: Array, end_m: Array) -> str:
    """Return the axis between two points (3,) [m] in ``base`` as the sentence that `direct` and `render` parse."""
    start, end = (", ".join(f"{value:.4f}" for value in point) for point in (start_m, end_m))
    return f"In the robot's base frame, in metres, the axis runs from ({start}) to ({end})."


def _axis_text(text: str) -> str:
    found = _AXIS.search(text)
    if found is None:
        raise CycleFailure(Code.MODEL_REFUSED, "The reasoning names no axis.")
    return found.group(0)
