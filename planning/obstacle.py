"""The obstacle of a rejected motion: which thing, where, and by how much too near. Frames: docs/frames.md."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import coal
import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, Transform
from bus.codes import Code
from bus.rejection import Obstacle, ObstacleKind
from config.scene import Box
from planning.height_field import CELL_M, OBSERVED, ObservedHeightField
from planning.infeasible import Infeasible
from planning.scene import TARGET, Scene, Width
from planning.world import Collision, Pair, Placed

Array = npt.NDArray[np.float64]

_FARTHEST_M, _STEPS = 0.06, 7
_SIDES = 8
"""Level directions in which the part is moved away, besides up."""
_SHOWN, _AROUND_M = 150, 0.08
"""Most points of an obstacle in the record, and how far from the touch they may lie."""


def in_the_way(
    name: str, collision: Collision | str, scene: Scene, width_m: Width, q_end_rad: Joints | None = None
) -> Infeasible:
    """Return the error of a motion that would touch something.

    Args:
        name: of the motion. ``width_m``: opening of the hand; None = any.
        q_end_rad: (joints,) where the motion would have gone on to; None = nowhere.
    """

    def look() -> Obstacle | None:
        if isinstance(collision, str) or collision.pair is None:
            return None
        scene.cancel.raise_if_set("plan")
        there = [collision.pair] if q_end_rad is None else [collision.pair.at(q_end_rad), collision.pair]
        return obstacle_of(collision, there, scene, width_m)

    by_hand = not isinstance(collision, str) and collision.by_hand
    return Infeasible(Code.COLLISION, f"{name}: {collision}", by_hand=by_hand, obstacle=look)


def obstacle_of(collision: Collision, there: Sequence[Pair], scene: Scene, width_m: Width) -> Obstacle:
    """Return what a part of the robot would touch, where it comes nearest.

    Args:
        there: the pair in the configurations to look at. ``width_m``: opening of the hand; None = any.
    """
    nearness = [_too_near_m(pair, scene) for pair in there]
    worst = int(np.argmax([np.inf if one is None else one for one in nearness]))
    pair, (part, name) = there[worst], _who(collision, there[worst])
    mover, other = _ordered(pair)
    kind, points = _shape(name, other, scene)
    touch = _nearest(_middle(mover), points, is_box=kind == "box")
    if name == OBSERVED and scene.field is not None:
        kind = _seen_or_not(scene.field, touch)
    return Obstacle(
        part=part,
        name=name,
        kind=kind,
        too_near_m=nearness[worst],
        needed_m=pair.needed_m,
        touch_m=touch,
        base_from_tcp=scene.robot.base_from_tcp(pair.q_rad),
        opening_m=width_m,
        points_m=_few(points, touch, is_box=kind == "box"),
    )


def _too_near_m(pair: Pair, scene: Scene) -> float | None:
    """Return how far the part would have to move; the least over all directions, bisected to half a millimetre."""
    (part, pose), other = _ordered(pair)
    closing = scene.robot.base_from_tcp(pair.q_rad)[:3, 1]
    first = float(np.arctan2(closing[1], closing[0]))
    turns = first + np.arange(_SIDES) * 2 * np.pi / _SIDES
    ways = [np.array([np.cos(turn), np.sin(turn), 0.0]) for turn in turns] + [np.array([0.0, 0.0, 1.0])]
    found = [_way_out_m(part, pose, other, way, pair.needed_m) for way in ways]
    return min((one for one in found if one is not None), default=None)


def _way_out_m(
    part: coal.CollisionGeometry, pose: Transform, other: Placed, way: Array, needed_m: float
) -> float | None:
    if _touch(part, pose, other, _FARTHEST_M * way, needed_m):
        return None
    low_m, high_m = 0.0, _FARTHEST_M
    for _ in range(_STEPS):
        middle_m = (low_m + high_m) / 2
        if _touch(part, pose, other, middle_m * way, needed_m):
            low_m = middle_m
        else:
            high_m = middle_m
    return high_m


def _touch(part: coal.CollisionGeometry, pose: Transform, other: Placed, shift_m: Array, needed_m: float) -> bool:
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.security_margin = needed_m
    moved = coal.Transform3s(pose[:3, :3], pose[:3, 3] + shift_m)
    coal.collide(part, moved, other[0], coal.Transform3s(other[1][:3, :3], other[1][:3, 3]), request, result)
    return bool(result.isCollision())


def _middle(part: Placed) -> Array:
    """The middle (3,) of a part's bounding box, in ``base``."""
    shape, pose = part
    shape.computeLocalAABB()
    return np.asarray(pose[:3, :3] @ shape.aabb_center + pose[:3, 3])


def _is_carried(pair: Pair) -> bool:
    return any(thing.held for thing in pair.things)


def _who(collision: Collision, pair: Pair) -> tuple[str, str]:
    """Return what moves, and what it would touch: the object in the hand moves, whatever the order of the two."""
    return (collision.other, collision.part) if _is_carried(pair) else (collision.part, collision.other)


def _ordered(pair: Pair) -> tuple[Placed, Placed]:
    """Return what moves, and what it would touch, with their places."""
    first, second = pair.placed()
    return (second, first) if _is_carried(pair) else (first, second)


def _shape(name: str, other: Placed, scene: Scene) -> tuple[ObstacleKind, Array]:
    """Return what kind of thing it is, and the points (n, 3) in ``base`` that show it."""
    boxes = {box.name: box for box in scene.boxes}
    if name in boxes:
        return "box", _corners(boxes[name])
    if name == OBSERVED and scene.field is not None:
        return "seen", scene.field.points
    if name == TARGET and scene.target is not None:
        return "target", scene.target
    return "robot", _middle(other)[None]


def _corners(box: Box) -> Array:
    signs = np.array(list(product((-0.5, 0.5), repeat=3)))
    return np.asarray(box.center_m + signs * np.array(box.size_m))


def _nearest(place: Array, points: Array, *, is_box: bool) -> Array:
    """The point (3,) of an obstacle that is nearest to a place; everything below a seen point is solid."""
    if is_box:
        return np.asarray(np.clip(place, points.min(axis=0), points.max(axis=0)))
    columns = np.column_stack([points[:, :2], np.minimum(points[:, 2], place[2])])
    return np.asarray(columns[int(np.linalg.norm(columns - place, axis=1).argmin())])


def _seen_or_not(field: ObservedHeightField, touch: Array) -> ObstacleKind:
    """``seen`` when something was measured where it touches, and at least as high."""
    measured = field.points[: field.seen]
    near = np.abs(measured[:, :2] - touch[:2]).max(axis=1) <= CELL_M
    return "seen" if (measured[near, 2] >= touch[2] - CELL_M).any() else "unseen"


def _few(points: Array, touch: Array, *, is_box: bool) -> npt.NDArray[np.float32]:
    if not is_box:
        points = points[np.linalg.norm(points[:, :2] - touch[:2], axis=1) < _AROUND_M]
        points = points[:: max(1, -(-len(points) // _SHOWN))]
    return np.asarray(points, dtype=np.float32)
