"""The reason why a scene with things in it yields no grasp, in words that say what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Instance, ObservedScene
from config.schema import Station
from perception.grasps.closing import Closings
from perception.grasps.no_room import cause_on
from perception.grasps.search import search
from perception.scene.scene import Scene

_NAMED, _TINY_M = 5, 1e-6


def why_none(
    failures: list[CycleFailure], closings: Closings, scene: Scene, seen: ObservedScene, station: Station
) -> CycleFailure:
    """Return the failure of a detection without any grasp.

    A model's failure stands as it is. Otherwise: NOT_SEEN when there would be grasps if the space that the camera did
    not see were free, else NO_GRASP.
    """
    of_model = [failure for failure in failures if failure.failure is not Code.NO_GRASP]
    if of_model:
        return of_model[0]
    if np.isfinite(closings.score).any() and failures:
        return failures[0]
    hidden = _hidden(scene, station)
    if hidden:
        text = f"{hidden} ways to grasp would be free if the camera saw the space beside them"
        return CycleFailure(Code.NOT_SEEN, f"{text}: look from above, or from another side.")
    jaw_m = station.hand.max_width_m
    narrowest = min(seen.instances, key=lambda one: float(one.size_m[1]))
    cause = cause_on(narrowest, scene, station)
    which = "" if len(seen.instances) == 1 else f" On the one of {_wide(narrowest)}"
    text = f"The jaw opens {jaw_m * 1e3:.0f} mm and finds no grasp on {_things(seen)}"
    text = f"{text}.{which}: {cause.text}." if which else f"{text}: {cause.text}."
    return CycleFailure(Code.NO_GRASP, text, advice=cause.advice)


def _wide(one: Instance) -> str:
    return f"{one.size_m[1] * 1e3:.0f} mm"


def _things(seen: ObservedScene) -> str:
    widths = [_wide(one) for one in seen.instances[:_NAMED]]
    if len(seen.instances) == 1:
        return f"the thing there, which is {widths[0]} wide"
    more = ", ..." if len(seen.instances) > _NAMED else ""
    return f"the {len(seen.instances)} things there, which are {', '.join(widths)}{more} wide"


def _hidden(scene: Scene, station: Station) -> int:
    """Count the closings that there would be if what was not seen were free down to the table."""
    heights = scene.heights
    is_unseen = heights.bound_m > heights.surface_m + _TINY_M
    surface_m = np.where(is_unseen, np.float32(0), heights.surface_m)
    free = replace(heights, surface_m=surface_m, bound_m=surface_m)
    return int(np.isfinite(search(free, station).score).sum())
