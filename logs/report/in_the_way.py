"""The things in the way of rejected grasps: in words, as a picture, and in 3-D, with the hand as it would be."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Detections
from bus.rejection import Obstacle, Rejection
from bus.transforms import apply, inverse
from config.franka_hand import FINGER_LENGTH_M, FINGER_TIP_M, FINGER_TIP_SIZE_M, PALM_ABOVE_TIP_M
from logs.mcap.reader import CycleRecord
from logs.report import images
from logs.report.clouds import among_points
from logs.report.images import Image
from logs.report.look_points import points_of_things, true_pose
from logs.report.out_of_reach import Cause, unreached
from logs.report.page import Figure
from logs.report.scene import pixels_of

_SIDES = ("front", "back", "left", "right")
_PHASES = {
    "before the grasp": "Before the approach",
    "approach": "On the approach",
    "lift": "While it lifts",
    "reach": "On the way there",
    "reach, at another width": "On the way there, at another width of the jaw,",
    "no way around": "On the way, with none found around it,",
    "carry": "On the way to the tray",
    "above the tray": "Above the tray",
    "lower": "While it lowers the object",
    "retreat": "While it leaves the tray",
    "place": "On the way into the tray",
    "home": "On the way home",
}
_HAND_RGB, _BLOCKED_RGB, _OBSTACLE_RGB, _TOUCH_RGB = (255, 170, 40), (235, 40, 60), (235, 40, 60), (255, 255, 255)
_PALM_M = (0.032, 0.102)
"""Half of the hand's body across and along the closing axis."""
_MARGIN_PX, _NEAREST, _CORNERS = 70, 15, 8
_LEAST_M = 0.001
_BELOW_MM = 10.0
"""A touch so near to the jaw's middle is below the hand, and not beside it."""

Array = npt.NDArray[np.float64]


class InTheWay(NamedTuple):
    """The obstacles on the page.

    Attributes:
        causes: the most frequent first. ``shown``: of the one that is drawn; else of the first.
        uri: the picture. ``cloud``: in 3-D. There is neither where only the arm's reach is to blame.
    """

    causes: list[Cause]
    shown: str
    uri: str
    cloud: Figure | None


def in_the_way(record: CycleRecord, found: Detections | None, rejected: Sequence[Rejection]) -> InTheWay | None:
    """Return what stood against the rejected grasps; None where nothing did, or an older recording does not say it."""
    if found is None or record.observation is None:
        return None
    groups: dict[str, list[Obstacle]] = defaultdict(list)
    for one in rejected:
        if one.obstacle is not None:
            groups[_told(record, found, one, one.obstacle)].append(one.obstacle)
    far = unreached(record, found, rejected)
    if not groups:
        return InTheWay(far, f"{far[0].text[:-1]}: {far[0].measured} ({far[0].limit})", "", None) if far else None
    by_count = sorted(groups.items(), key=lambda group: -len(group[1]))
    text, (first, *_) = by_count[0]
    return InTheWay(
        [*(_cause(text, group) for text, group in by_count), *far],
        text + _beside(first) + _by_how_much(first),
        images.data_uri(_picture(record, found, first)),
        _cloud(record, found, first),
    )


def _cause(text: str, group: Sequence[Obstacle]) -> Cause:
    known_m = sorted(one.too_near_m for one in group if one.too_near_m is not None)
    if not known_m:
        too_near = "more than 60 mm"
    elif len(known_m) < len(group):
        too_near = f"{_mm(known_m[0])} to more than 60 mm"
    else:
        low, high = _mm(known_m[0]), _mm(known_m[-1])
        too_near = f"{low} mm" if low == high else f"{low} to {high} mm"
    return Cause(len(group), text + ".", f"{too_near} too near", f"{group[0].needed_m * 1e3:g} mm must stay free")


# --- in words ---------------------------------------------------------------------------------------------------------


def _told(record: CycleRecord, found: Detections, rejection: Rejection, one: Obstacle) -> str:
    """Without a full stop: "On the approach the left finger would touch thing 2"."""
    phase = _PHASES.get(rejection.reason.partition(":")[0], "")
    part = f"the {one.part}"
    what = _named(record, found, found.grasps[rejection.grasp].instance, one)
    begin = f"{phase} {part}" if phase else part.capitalize()
    return f"{begin} would touch {what}"


def _beside(one: Obstacle) -> str:
    away_mm = float(np.linalg.norm((one.touch_m - one.base_from_tcp[:3, 3])[:2]) * 1e3)
    is_below = one.kind == "robot" or away_mm < _BELOW_MM
    return "" if is_below else f", {round(away_mm)} mm beside the middle of the jaw"


def _by_how_much(one: Obstacle) -> str:
    """Say how much too near, and the room that is needed."""
    if one.too_near_m is None:
        return f": more than 60 mm too near ({one.needed_m * 1e3:g} mm must stay free)"
    return f": {_mm(one.too_near_m)} mm too near ({one.needed_m * 1e3:g} mm must stay free)"


def _mm(length_m: float) -> str:
    return f"{length_m * 1e3:.0f}" if length_m >= _LEAST_M else "less than 1"


def _named(record: CycleRecord, found: Detections, target: int, one: Obstacle) -> str:
    if one.kind == "box":
        stem, _, side = one.name.rpartition("-")
        return f"the {side} wall of the {stem}" if stem and side in _SIDES else f"the {one.name}"
    if one.kind == "target":
        return "the object itself"
    if one.kind == "robot":
        return f"the {one.name}"
    if one.kind == "unseen":
        return "space that the camera did not see"
    number = _thing_there(record, found, one)
    if number == target:
        return "what was seen of the object's own side"
    return f"thing {number}" if number else "something that was seen"


def _thing_there(record: CycleRecord, found: Detections, one: Obstacle) -> int:
    """The number of the thing that the obstacle's points nearest to the touch belong to, in the picture; 0 for none."""
    away_m = np.linalg.norm(one.points_m[:, :2] - one.touch_m[:2], axis=1)
    pixels = _in_picture(record, one.points_m[np.argsort(away_m, kind="stable")[:_NEAREST]].astype(float))
    labels = found.scene.labels
    if pixels is None:
        return 0
    u, v = np.rint(pixels).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < labels.shape[1]) & (v < labels.shape[0])
    numbers = labels[v[inside], u[inside]]
    numbers = numbers[numbers > 0]
    return int(np.bincount(numbers).argmax()) if len(numbers) else 0


# --- as a picture -----------------------------------------------------------------------------------------------------


def _in_picture(record: CycleRecord, points_base: Array) -> Array | None:
    """Pixels (n, 2) of points (n, 3) in the look that is shown; None when one lies behind the camera."""
    assert record.observation is not None
    color_from_base = inverse(np.asarray(true_pose(record.observation, record.scene)))
    return pixels_of(apply(color_from_base, points_base), record.observation.frame.color_camera)


def _picture(record: CycleRecord, found: Detections, one: Obstacle) -> Image:
    """The colour image around the place: the obstacle red, the hand orange, its part that touches red."""
    image, drawn = np.array(found.evidence.color), list[Array]()
    obstacle = _in_picture(record, one.points_m.astype(float))
    if obstacle is not None and _is_box(one):
        _filled(image, obstacle, _OBSTACLE_RGB)
    elif obstacle is not None:
        for u, v in np.rint(obstacle).astype(int):
            cv2.circle(image, (int(u), int(v)), 2, _OBSTACLE_RGB, -1, cv2.LINE_AA)
        drawn.append(obstacle)
    for name, corners in hand_corners(one).items():
        pixels = _in_picture(record, corners)
        if pixels is not None:
            _outlined(image, pixels, _BLOCKED_RGB if name == one.part else _HAND_RGB, 3 if name == one.part else 2)
            drawn.append(pixels)
    touch = _in_picture(record, one.touch_m[None])
    if touch is not None:
        place = (round(float(touch[0, 0])), round(float(touch[0, 1])))
        cv2.circle(image, place, 9, _TOUCH_RGB, 4, cv2.LINE_AA)
        cv2.circle(image, place, 9, _BLOCKED_RGB, 2, cv2.LINE_AA)
        drawn.append(touch)
    return images.crop(image, _mask_of(drawn, image.shape[:2]), margin_px=_MARGIN_PX)


def _mask_of(drawn: Sequence[Array], shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    mask = np.zeros(shape, dtype=bool)
    if drawn:
        u, v = np.rint(np.concatenate(drawn)).astype(int).T
        mask[np.clip(v, 0, shape[0] - 1), np.clip(u, 0, shape[1] - 1)] = True
    return mask


def _outlined(image: Image, pixels: Array, rgb: tuple[int, int, int], width_px: int) -> None:
    cv2.polylines(image, [_hull(pixels)], True, (20, 20, 20), width_px + 2, cv2.LINE_AA)
    cv2.polylines(image, [_hull(pixels)], True, rgb, width_px, cv2.LINE_AA)


def _filled(image: Image, pixels: Array, rgb: tuple[int, int, int]) -> None:
    layer = image.copy()
    cv2.fillConvexPoly(layer, _hull(pixels), rgb, cv2.LINE_AA)
    image[:] = cv2.addWeighted(layer, 0.35, image, 0.65, 0.0)
    cv2.polylines(image, [_hull(pixels)], True, rgb, 1, cv2.LINE_AA)


def _hull(pixels: Array) -> npt.NDArray[np.int32]:
    return np.asarray(cv2.convexHull(np.rint(pixels).astype(np.int32)), dtype=np.int32)


def hand_corners(one: Obstacle) -> dict[str, Array]:
    """Return the corners (8, 3) in ``base`` of both fingers and of the hand's body, by the part's name."""
    half_m = (one.opening_m if one.opening_m is not None else 0.0) / 2
    across_m, along_m = FINGER_TIP_SIZE_M
    root_m, body_m = FINGER_TIP_M - FINGER_LENGTH_M, FINGER_TIP_M - PALM_ABOVE_TIP_M
    boxes = {
        "hand": ((-_PALM_M[0], _PALM_M[0]), (-_PALM_M[1], _PALM_M[1]), (body_m - 0.066, body_m)),
        "left finger": ((-across_m / 2, across_m / 2), (half_m, half_m + along_m), (root_m, FINGER_TIP_M)),
        "right finger": ((-across_m / 2, across_m / 2), (-half_m - along_m, -half_m), (root_m, FINGER_TIP_M)),
    }
    return {name: apply(_pose(one), np.array(list(product(*sides)))) for name, sides in boxes.items()}


def _is_box(one: Obstacle) -> bool:
    return one.kind == "box" and len(one.points_m) == _CORNERS


def _pose(one: Obstacle) -> Transform:
    return np.asarray(one.base_from_tcp, dtype=float)


# --- in 3-D -----------------------------------------------------------------------------------------------------------


def _cloud(record: CycleRecord, found: Detections, one: Obstacle) -> Figure:
    things = np.concatenate(points_of_things(found.scene, record.looks))
    near = things[np.linalg.norm(things[:, :2] - one.touch_m[:2], axis=1) < 0.20]
    corners = hand_corners(one)
    return among_points(near, one.points_m.astype(float), one.touch_m, corners, one.part, is_box=_is_box(one))
