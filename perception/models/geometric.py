"""The embedded goal-image model: it reasons from depth and silhouette, and paints the rod itself.

It needs no network and no training, and is deterministic. One instance works on one object at a time.
"""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.transforms import apply, inverse
from config.schema import Station
from perception.grasps import antipodal
from perception.grasps.antipodal import Closings
from perception.models.painter import paint
from perception.observed_object import Answer, ObservedObject

_STICK_OUT_M = 0.035
_COVER_M = 0.002
_NUMBER = r"(-?\d+\.\d+)"
_AXIS = re.compile(rf"from \({_NUMBER}, {_NUMBER}, {_NUMBER}\) to \({_NUMBER}, {_NUMBER}, {_NUMBER}\)")

Array = npt.NDArray[np.float64]


class GeometricModel:
    """Antipodal reasoning on the observed height map, and a shaded cylinder along the chosen axis.

    Asked again in the same cycle, it proposes the next best distinct axis.
    """

    name = "geometric"

    def __init__(self, station: Station) -> None:
        self._station = station
        self.begin()

    def begin(self) -> None:
        """Begin a cycle; the proposals start from the best axis again."""
        self._proposed: list[int] = []  # a new list: a call that a stop left running may still append to the old one

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        """Refuse any image (H, W, 3), because it understands no words. Raises: CycleFailure(TARGET_NOT_FOUND)."""
        text = "The embedded model understands no words: name the target by its pixel."
        raise CycleFailure(Code.TARGET_NOT_FOUND, text)

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """The best antipodal axis, as text. Raises: CycleFailure(NO_GRASP)."""
        proposed = self._proposed
        closings = antipodal.propose(observed_object.heights, self._station)
        ranked = closings.distinct(len(proposed) + 1)
        if len(ranked) <= len(proposed):
            raise CycleFailure(Code.NO_GRASP, "No two opposite faces fit the jaw and can be reached from above.")
        chosen = ranked[len(proposed)]
        proposed.append(chosen)
        scene = observed_object.scene
        return Answer(
            f"The object is {scene.height_m[scene.object_mask].max() * 1e3:.0f} mm high. Two opposite faces "
            f"{closings.width_m[chosen] * 1e3:.1f} mm apart fit the jaw; of {np.isfinite(closings.score).sum()} "
            f"feasible axes this one scores {closings.score[chosen]:.2f}. "
            + axis_in_words(*self._axis(closings, chosen))
        )

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """The axis as an editing instruction."""
        return Answer(f"Draw a straight cylinder {_axis_text(prompt)} (base frame, metres) through the object.")

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Paint the rod; parts behind the object stay hidden. Without an axis in the prompt it reasons first."""
        text = prompt if _AXIS.search(prompt) else self.reason(observed_object, prompt, cancel).text
        axis = _axis_text(text)
        ends_base = np.array([float(value) for value in re.findall(_NUMBER, axis)]).reshape(2, 3)
        ends = apply(inverse(observed_object.base_from_color), ends_base)
        return Answer(f"rod {axis}", goal=paint(observed_object, ends, self._station.perception.rod_radius_m))

    def close(self) -> None:
        """Do nothing; there are no resources."""

    def _axis(self, closings: Closings, index: int) -> tuple[Array, Array]:
        """Ends (3,), (3,) of the rod in ``base`` [m]: at the contacts' height, inside the object, above the table."""
        radius_m, heading = self._station.perception.rod_radius_m, closings.heading_rad[index]
        half = (closings.width_m[index] / 2 + _STICK_OUT_M) * np.array([np.cos(heading), np.sin(heading), 0.0])
        level_m = max(min(closings.tcp_m[index], closings.edge_m[index] - radius_m - _COVER_M), radius_m + _COVER_M / 2)
        center = np.append(closings.center_m[index], level_m)
        return center - half, center + half


def axis_in_words(start_m: Array, end_m: Array) -> str:
    """The axis between two points (3,) [m] in ``base`` as the sentence that `direct` and `render` parse."""
    start, end = (", ".join(f"{value:.4f}" for value in point) for point in (start_m, end_m))
    return f"In the robot's base frame, in metres, the axis runs from ({start}) to ({end})."


def _axis_text(text: str) -> str:
    found = _AXIS.search(text)
    if found is None:
        raise CycleFailure(Code.MODEL_REFUSED, "The reasoning names no axis.")
    return found.group(0)
