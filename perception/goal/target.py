"""Chooses the targets among the things in the pick region: by words, pixel, box or point, or by the best grasps."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.arrays import Vector3
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Instance
from bus.transforms import apply, inverse
from config.schema import Station
from config.target import outside_picture
from config.words import understood
from perception.geometry.crop import Mask
from perception.geometry.lift import project
from perception.goal.described import all_in_words, in_words, pixels_of, wanted_of
from perception.goal.imagine import Conversation
from perception.goal.prompts import prompt
from perception.grasps.closing import Closings
from perception.models.registry import reads_text
from perception.models.sam import Sam
from perception.scene.heightmap import CELL_M
from perception.scene.scene import Scene
from perception.scene.stacked import lying_on

_NEAR_PX = 40.0
"""Largest distance [px] of a given pixel from the thing it selects."""
_NEAR_M = 0.015
"""A thing so near to a place is the one meant by it, or the one that failed there, though it was touched."""
_MOSTLY = 0.5
_PIXEL = re.compile(r"(\d+)\D+(\d+)")


def choose(
    scene: Scene,
    instances: Sequence[Instance],
    closings: Closings,
    talk: Conversation,
    station: Station,
    sam: Sam | None = None,
) -> list[int]:
    """Return the numbers of the targets, the best first (`config.target.TargetSettings`).

    Args:
        instances: the things of the scene.
        closings: of the search over the whole scene, which rank the things when no certain one is named.
        sam: finds a target given in words, if it reads text; otherwise the goal-image model locates it, or, if that
            is an embedded one, the words of `config.words` are understood.

    Raises: CycleFailure(TARGET_NOT_FOUND), which says what was seen instead; OBSTRUCTED when something lies on the one
        that is named; as the model, when the model is asked.
    """
    return among(scene, instances, by_best_grasp(scene, closings), talk, station, sam)


def among(
    scene: Scene,
    instances: Sequence[Instance],
    ranked: list[int],
    talk: Conversation,
    station: Station,
    sam: Sam | None = None,
) -> list[int]:
    """Return the targets among things that are ranked already, the best first. Raises: CycleFailure, as `choose`."""
    if not station.perception.target.is_named:
        return ranked
    try:
        found = _named(scene, instances, ranked, talk, station, sam)
    except CycleFailure as failure:
        if failure.failure is not Code.TARGET_NOT_FOUND:
            raise
        raise CycleFailure(failure.failure, f"{failure.text} {all_in_words(scene, instances)}") from failure
    return _reachable_from_above(scene, instances, found)


def _named(
    scene: Scene,
    instances: Sequence[Instance],
    ranked: list[int],
    talk: Conversation,
    station: Station,
    sam: Sam | None,
) -> list[int]:
    """The things that the target names, the best first. Raises: CycleFailure, as `choose`."""
    target = station.perception.target
    if target.text is not None and sam is not None and sam.reads_text:
        return [_most_covered(scene, sam.by_text(scene.rgbd.color, target.text), target.text)]
    if target.text is not None and reads_text(station.perception.model):
        return [at_pixel(scene, _pointed_at(target.text, scene.rgbd.color, talk, station))]
    if target.text is not None:
        return _described(scene, instances, ranked, target.text, station)
    if target.box is not None:
        return _in_box(scene, ranked, target.box)
    if target.point_m is not None:
        return [_at_point(scene, target.point_m)]
    assert target.pixel is not None, "one of the four is set"
    return [at_pixel(scene, target.pixel)]


def _reachable_from_above(scene: Scene, instances: Sequence[Instance], found: list[int]) -> list[int]:
    """Those of the named things on which nothing lies. Raises: CycleFailure(OBSTRUCTED) when all are covered."""
    above = {number: lying_on(scene, number) for number in found}
    free = [number for number in found if not above[number]]
    if free or not found:
        return free

    def said(one: Instance) -> str:
        return in_words(pixels_of(scene, one.number), one)

    by_number = {one.number: one for one in instances}
    first, blocker = found[0], by_number[above[found[0]][0]]
    raise CycleFailure(
        Code.OBSTRUCTED,
        f"On the target ({said(by_number[first])}) lies something: {said(blocker)}.",
        obstacle_m=blocker.top_m,
    )


def _described(
    scene: Scene, instances: Sequence[Instance], ranked: list[int], text: str, station: Station
) -> list[int]:
    try:
        wanted = understood(text, station.perception.labels)
    except ValueError as why:
        raise CycleFailure(Code.TARGET_NOT_FOUND, f"The words of the target: {why}.") from why
    found = wanted_of(scene, instances, wanted, ranked)
    if not found:
        raise CycleFailure(Code.TARGET_NOT_FOUND, f"Nothing here is {text!r}.")
    return found


def _in_box(scene: Scene, ranked: list[int], box: tuple[float, float, float, float]) -> list[int]:
    _require_in_picture(None, box, scene.color_labels)
    inside = mostly_in_box(scene.color_labels, box)
    found = [number for number in ranked if number in inside]
    if not found:
        raise CycleFailure(Code.TARGET_NOT_FOUND, f"No object lies mostly in the box {box}.")
    return found


def mostly_in_box(labels: npt.NDArray[np.integer[Any]], box: tuple[float, float, float, float]) -> list[int]:
    """Return the things of which more than half, of what is in the picture, lies in a box (u_min, v_min, u_max, v_max).

    Args:
        labels: (H, W) the number of the thing in each pixel, 0 = none.
    """
    u_min, v_min, u_max, v_max = (round(edge) for edge in box)
    everywhere = np.bincount(labels.ravel())
    part = labels[max(v_min, 0) : max(v_max + 1, 0), max(u_min, 0) : max(u_max + 1, 0)]
    inside = np.bincount(part.ravel(), minlength=len(everywhere))
    return [int(number) for number in np.flatnonzero(inside > _MOSTLY * everywhere) if number]


def _at_point(scene: Scene, point_base: Sequence[float]) -> int:
    """The thing at a point (3,) in ``base``, or the nearest one within 15 mm across."""
    near = _near(scene, np.asarray(point_base))
    if not near:
        x, y = point_base[0], point_base[1]
        where = "" if _is_in_picture(scene, np.asarray(point_base)) else " That point is outside the picture."
        raise CycleFailure(
            Code.TARGET_NOT_FOUND, f"There is no object within {_NEAR_M * 1e3:.0f} mm of ({x:.3f}, {y:.3f}).{where}"
        )
    return near[0]


def _is_in_picture(scene: Scene, point_base: Vector3) -> bool:
    """Whether the look that is shown has a point (3,) of ``base`` in it, seen or hidden."""
    camera, at = scene.rgbd.camera, apply(inverse(scene.base_from_color), point_base[None])
    ((u, v),) = project(at, camera)
    return bool(at[0, 2] > 0 and 0 <= u < camera.width and 0 <= v < camera.height)


def by_best_grasp(scene: Scene, closings: Closings) -> list[int]:
    """Every thing of the scene, the one with the best closing first; those without any last, the largest first."""
    best = np.full(scene.count + 1, -np.inf)
    np.maximum.at(best, closings.instance, closings.score)
    return [int(number) for number in np.argsort(-best[1:], kind="stable") + 1]


def at_pixel(scene: Scene, pixel: tuple[float, float]) -> int:
    """Return the thing at a pixel (u, v), or the nearest one within 40 px. Raises: CycleFailure(TARGET_NOT_FOUND)."""
    return nearest_number(scene.color_labels, pixel)


def nearest_number(labels: npt.NDArray[np.integer[Any]], pixel: tuple[float, float]) -> int:
    """As `at_pixel`, in an image (H, W) of the things' numbers, 0 = none."""
    _require_in_picture(pixel, None, labels)
    rows, columns = np.nonzero(labels)
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
    return int(labels[rows[nearest], columns[nearest]])


def _require_in_picture(
    pixel: tuple[float, float] | None,
    box: tuple[float, float, float, float] | None,
    labels: npt.NDArray[np.integer[Any]],
) -> None:
    """Raises: CycleFailure(TARGET_NOT_FOUND) where a pixel or box is outside the picture of these labels (H, W)."""
    height, width = labels.shape
    if why := outside_picture(pixel, box, (width, height)):
        raise CycleFailure(Code.TARGET_NOT_FOUND, f"{why[0].upper()}{why[1:]}.")


def untried(scene: Scene, targets: list[int], failed_at: Sequence[Vector3]) -> list[int]:
    """Return the targets without the things at places (3,) in ``base`` where picks failed.

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


def _near(scene: Scene, place_base: Vector3) -> list[int]:
    """The numbers of the things beneath a place (3,), or beside it, the nearest first."""
    heights, reach = scene.heights, round(_NEAR_M / CELL_M)
    at = apply(scene.table.table_from_base, np.asarray(place_base)[None])[0, :2]
    column, row = np.rint((at - heights.origin_m) / CELL_M).astype(int)
    top, left = max(row - reach, 0), max(column - reach, 0)
    window = heights.labels[top : max(row + reach + 1, 0), left : max(column + reach + 1, 0)]
    rows, columns = np.nonzero(window)
    order = np.argsort(np.hypot(rows + top - row, columns + left - column), kind="stable")
    return list(dict.fromkeys(window[rows[order], columns[order]].tolist()))


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
