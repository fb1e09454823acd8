"""Chooses the target among the objects in the pick region: by words, by a pixel, or the one with the best grasp."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from config.schema import Station
from perception.goal.imagine import Conversation
from perception.goal.prompts import prompt
from perception.grasps import antipodal
from perception.models.sam import Sam
from perception.scene.heightmap import height_map
from perception.scene.segment import Mask, Scene

_NEAR_PX = 40.0
"""Largest distance [px] of a given pixel from the outline of the object it selects."""
_PIXEL = re.compile(r"(\d+)\D+(\d+)")


def choose(
    scenes: Sequence[Scene], color: npt.NDArray[np.uint8], talk: Conversation, station: Station, sam: Sam | None = None
) -> Scene:
    """The scene whose object is the target (`config.schema.PerceptionSettings.target`).

    Args:
        scenes: one per object in the pick region. ``color``: (H, W, 3) RGB.
        sam: finds a target given in words, if it reads text; otherwise the goal-image model locates it.

    Raises: CycleFailure(TARGET_NOT_FOUND); as the model, when the model is asked.
    """
    target = station.perception.target
    if target.text is not None and sam is not None and sam.reads_text:
        return _most_covered(scenes, sam.by_text(color, target.text), target.text)
    if target.text is not None:
        return at_pixel(scenes, _pointed_at(target.text, color, talk, station))
    if target.pixel is not None:
        return at_pixel(scenes, target.pixel)
    if len(scenes) == 1:
        return scenes[0]
    scores = [_graspable(scene, station) for scene in scenes]
    return scenes[int(np.argmax(scores))]


def at_pixel(scenes: Sequence[Scene], pixel: tuple[float, float]) -> Scene:
    """The object at a pixel (u, v), or the nearest one within 40 px. Raises: CycleFailure(TARGET_NOT_FOUND)."""
    distances = [_distance_px(scene.object_mask, pixel) for scene in scenes]
    nearest = int(np.argmin(distances))
    if distances[nearest] > _NEAR_PX:
        raise CycleFailure(
            Code.TARGET_NOT_FOUND,
            f"There is no object within {_NEAR_PX:.0f} px of ({pixel[0]:.0f}, {pixel[1]:.0f}); the nearest is "
            f"{distances[nearest]:.0f} px away.",
        )
    return scenes[nearest]


def _most_covered(scenes: Sequence[Scene], mask: Mask, text: str) -> Scene:
    shared = [int((scene.object_mask & mask).sum()) for scene in scenes]
    if max(shared) == 0:
        raise CycleFailure(Code.TARGET_NOT_FOUND, f"What SAM takes for {text!r} is no object in the pick region.")
    return scenes[int(np.argmax(shared))]


def _pointed_at(text: str, color: npt.NDArray[np.uint8], talk: Conversation, station: Station) -> tuple[float, float]:
    """The pixel (u, v) of the colour image that the model points at."""
    size_px = station.perception.hosted.size_px
    question = prompt("locate", size_px=str(size_px), target=text)
    answer = talk.ask("locate", question, lambda: talk.model.locate(color, question, talk.cancel)).text
    found = _PIXEL.search(answer)
    if found is None:
        raise CycleFailure(Code.TARGET_NOT_FOUND, f"The model does not see {text!r}: {answer.strip()[:120]}")
    shrink = max(color.shape[:2]) / size_px
    return float(found.group(1)) * shrink, float(found.group(2)) * shrink


def _graspable(scene: Scene, station: Station) -> float:
    scores = antipodal.propose(height_map(scene), station).score
    return float(scores.max()) if len(scores) else -np.inf


def _distance_px(mask: Mask, pixel: tuple[float, float]) -> float:
    rows, columns = np.nonzero(mask)
    return float(np.hypot(columns - pixel[0], rows - pixel[1]).min())
