"""Chooses the targets among the things in the pick region: by words, by a pixel, or those with the best grasps."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bus.arrays import Vector3
from bus.codes import Code
from bus.errors import CycleFailure
from bus.transforms import apply
from config.schema import Station
from perception.geometry.crop import Mask
from perception.goal.imagine import Conversation
from perception.goal.prompts import prompt
from perception.grasps.closing import Closings
from perception.models.sam import Sam
from perception.scene.heightmap import CELL_M
from perception.scene.scene import Scene

_NEAR_PX = 40.0
"""Largest distance [px] of a given pixel from the thing it selects."""
_FAILED_NEAR_M = 0.015
"""What lies so near to a place where a pick failed is what failed there, though it was touched."""
_PIXEL = re.compile(r"(\d+)\D+(\d+)")


def choose(scene: Scene, closings: Closings, talk: Conversation, station: Station, sam: Sam | None = None) -> list[int]:
    """The numbers of the targets, the best first (`config.schema.PerceptionSettings.target`).

    Args:
        closings: of the search over the whole scene, which rank the things when no target is named.
        sam: finds a target given in words, if it reads text; otherwise the goal-image model locates it.

    Raises: CycleFailure(TARGET_NOT_FOUND); as the model, when the model is asked.
    """
    found = named(scene, talk, station, sam)
    return by_best_grasp(scene, closings) if found is None else [found]


def named(scene: Scene, talk: Conversation, station: Station, sam: Sam | None = None) -> int | None:
    """The number of the target that the station names; None when it names none. Raises: CycleFailure, as `choose`."""
    target = station.perception.target
    if target.text is not None and sam is not None and sam.reads_text:
        return _most_covered(scene, sam.by_text(scene.rgbd.color, target.text), target.text)
    if target.text is not None:
        return at_pixel(scene, _pointed_at(target.text, scene.rgbd.color, talk, station))
    if target.pixel is not None:
        return at_pixel(scene, target.pixel)
    return None


def by_best_grasp(scene: Scene, closings: Closings) -> list[int]:
    """Every thing of the scene, the one with the best closing first; those without any last, the largest first."""
    best = np.full(scene.count + 1, -np.inf)
    np.maximum.at(best, closings.instance, closings.score)
    return [int(number) for number in np.argsort(-best[1:], kind="stable") + 1]


def at_pixel(scene: Scene, pixel: tuple[float, float]) -> int:
    """The thing at a pixel (u, v), or the nearest one within 40 px. Raises: CycleFailure(TARGET_NOT_FOUND)."""
    rows, columns = np.nonzero(scene.color_labels)
    if not len(rows):
        raise CycleFailure(Code.TARGET_NOT_FOUND, "None of the things is in the picture that is shown.")
    distance = np.hypot(columns - pixel[0], rows - pixel[1])
    nearest = int(np.argmin(distance))
    if distance[nearest] > _NEAR_PX:
        raise CycleFailure(
            Code.TARGET_NOT_FOUND,
            f"There is no object within {_NEAR_PX:.0f} px of ({pixel[0]:.0f}, {pixel[1]:.0f}); the nearest is "
            f"{distance[nearest]:.0f} px away.",
        )
    return int(scene.color_labels[rows[nearest], columns[nearest]])


def untried(scene: Scene, targets: list[int], failed_at: Sequence[Vector3]) -> list[int]:
    """The targets without the things at places (3,) in ``base`` where picks failed.

    Raises: CycleFailure(LEFT_OVER) when no other is left.
    """
    failed = {number for place in failed_at for number in _near(scene, place)}
    left = [number for number in targets if number not in failed]
    if targets and not left:
        places = ", ".join(f"({x:.2f}, {y:.2f})" for x, y, _ in failed_at)
        raise CycleFailure(
            Code.LEFT_OVER, f"Only things are left that failed before, where the hand closed at x, y = {places} m."
        )
    return left


def _near(scene: Scene, place_base: Vector3) -> set[int]:
    """The numbers of the things beneath a place (3,)."""
    heights, reach = scene.heights, round(_FAILED_NEAR_M / CELL_M)
    at = apply(scene.table.table_from_base, np.asarray(place_base)[None])[0, :2]
    column, row = np.rint((at - heights.origin_m) / CELL_M).astype(int)
    low_row, low_column = max(row - reach, 0), max(column - reach, 0)
    window = heights.labels[low_row : max(row + reach + 1, 0), low_column : max(column + reach + 1, 0)]
    return set(np.unique(window).tolist()) - {0}


def _most_covered(scene: Scene, mask: Mask, text: str) -> int:
    shared = np.bincount(scene.color_labels[mask], minlength=scene.count + 1)[1:]
    if shared.max() == 0:
        raise CycleFailure(Code.TARGET_NOT_FOUND, f"What SAM takes for {text!r} is no object in the pick region.")
    return int(shared.argmax()) + 1


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
