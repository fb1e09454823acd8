"""One collision world: the robot's parts, the things around it, and the clearance of each pair (Pinocchio, coal)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import Joints, Transform
from planning.robot import Robot, part_name

Mask = npt.NDArray[np.bool_]

FINGERS = frozenset({"left finger", "right finger"})
_RIGID = FINGERS | {"hand", "camera"}
"""Parts whose pose follows from the tcp's alone."""


def _neighbours(last_link: str) -> set[frozenset[str]]:
    """Return parts that always overlap or cannot reach each other; tests/planning/test_world.py measures both."""
    number = int(last_link.removeprefix("link "))
    pairs = (
        *((f"link {i}", f"link {i + 1}") for i in range(number)),
        ("link 5", "link 7"),  # of the FR3
        *combinations(sorted({*_RIGID, last_link}), 2),
    )
    return {frozenset(pair) for pair in pairs}


@dataclass(frozen=True)
class Thing:
    """A collision object that is not part of the robot.

    Attributes:
        name: for people. ``shape``: its geometry; ``pose``: (4, 4) in ``base``, or in the hand if it is ``held``.
        near: parts of the robot that may touch it.
    """

    name: str
    shape: coal.CollisionGeometry
    pose: Transform = field(default_factory=lambda: np.eye(4))
    near: frozenset[str] = frozenset()
    held: bool = False


@dataclass(frozen=True)
class Collision:
    """A pair that comes nearer than its margin, e.g. ``right finger touches table``.

    Attributes:
        by_hand: a part of the hand, or what it holds, touches a fixed thing: every arm configuration with this hand
            pose collides.
        pair: the two, in the world and the configuration in which they were found.
    """

    part: str
    other: str
    by_hand: bool
    pair: Pair | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.part} touches {self.other}"


@dataclass(frozen=True, eq=False)
class Pair:
    """Two shapes of a world in one configuration.

    Attributes:
        first, second: indices in the world. ``q_rad``: (n,). ``width_m``: opening of the hand, as the world was asked.
        needed_m: their smallest allowed distance.
    """

    world: World
    first: int
    second: int
    q_rad: Joints
    width_m: float
    needed_m: float

    def at(self, q_rad: Joints) -> Pair:
        """Return the same two in another configuration (n,)."""
        return replace(self, q_rad=q_rad)

    @property
    def things(self) -> tuple[Thing, ...]:
        """The one that is no part of the robot; empty when both are parts."""
        return self.world.things_of(self.second)

    def placed(self) -> tuple[Placed, Placed]:
        """Return both shapes, and where they are in ``base``."""
        return self.world.placed(self)


Placed = tuple[coal.CollisionGeometry, Transform]
"""A shape and its pose (4, 4) in ``base``."""


def held_thing(shape: coal.CollisionGeometry, hand_from_shape: Transform, last_link: str) -> Thing:
    """Return the held object: it moves with the hand at ``hand_from_shape`` (4, 4), which it touches."""
    return Thing("held object", shape, hand_from_shape, _RIGID | {last_link}, held=True)


@dataclass
class Effort:
    """Work done so far, counted and not timed, so that the same inputs get the same share of it.

    Attributes:
        checks: number of configurations checked.
    """

    checks: int = 0


class World:
    """Checks single configurations for collisions. Not thread-safe.

    Args:
        parts: the robot's, `Robot.hulls` or `Robot.meshes`.
        margin_m: smallest allowed distance of every pair.
        finger_margin_m: the same between the fingers and things.
        wide_margins_m: larger margins for every pair, used by ``collision(wide=index)``.
        effort: counts the checks of several worlds together.

    Attributes:
        checks: number of configurations checked so far.
    """

    def __init__(
        self,
        robot: Robot,
        parts: Sequence[pin.GeometryObject],
        things: Iterable[Thing],
        *,
        margin_m: float,
        finger_margin_m: float,
        wide_margins_m: Sequence[float] = (),
        effort: Effort | None = None,
    ) -> None:
        self.robot = robot
        self._things = tuple(things)
        self._robot_parts = len(parts)
        self._names = [*_part_names(tuple(part.name for part in parts)), *(thing.name for thing in self._things)]
        self._model = pin.GeometryModel()
        for part in parts:
            self._model.addGeometryObject(part)
        for number, thing in enumerate(self._things):
            self._model.addGeometryObject(self._placed(f"thing {number}", thing))
        self._model.setCollisionPairs(self._pairs())
        self._data = robot.model.createData()
        self._full = np.zeros(robot.model.nq)
        margins = np.full((len(self._names), len(self._names)), margin_m)
        fingers = [index for index, name in enumerate(self._names) if name in FINGERS]
        margins[np.ix_(fingers, range(self._robot_parts, len(self._names)))] = finger_margin_m
        self._margins = margins
        self._fine = self._level(margins)
        self._wide = tuple(self._level(np.full_like(margins, wide_m)) for wide_m in wide_margins_m)
        self.checks = 0
        self._effort = effort or Effort()

    def collision(self, q_rad: Joints, width_m: float, *, wide: int | None = None) -> Collision | None:
        """Return a pair nearer than its margin in the configuration ``q_rad`` (n,); None if there is none.

        Args:
            width_m: opening of the hand.
            wide: index of the wider margin to use instead.
        """
        self.checks += 1
        self._effort.checks += 1
        geometry, manager = self._fine if wide is None else self._wide[wide]
        self._full[:-2], self._full[-2:] = q_rad, width_m / 2
        pin.updateGeometryPlacements(self.robot.model, self._data, self._model, geometry, self._full)
        manager.update(False)
        callback = pin.CollisionCallBackDefault(self._model, geometry, True)
        manager.collide(callback)
        if not callback.collision:
            return None
        pair = self._model.collisionPairs[callback.collisionPairIndex]
        found = Pair(self, pair.first, pair.second, np.array(q_rad), width_m, self._margins[pair.first, pair.second])
        by_hand = self._goes_with_hand(pair.first, pair.second) or self._goes_with_hand(pair.second, pair.first)
        return Collision(self._names[pair.first], self._names[pair.second], by_hand=by_hand, pair=found)

    def _goes_with_hand(self, moving: int, standing: int) -> bool:
        """Whether the first is a part of the hand, or held in it, and the second a fixed thing."""
        is_held = any(thing.held for thing in self.things_of(moving))
        is_fixed = any(not thing.held for thing in self.things_of(standing))
        return is_fixed and (is_held or self._names[moving] in _RIGID)

    def things_of(self, index: int) -> tuple[Thing, ...]:
        """Return the thing with the index of a `Pair`; empty for a part of the robot."""
        return self._things[index - self._robot_parts : index - self._robot_parts + 1] if self._is_thing(index) else ()

    def placed(self, pair: Pair) -> tuple[Placed, Placed]:
        """Return the shapes of a pair, and where they are."""
        geometry, _ = self._fine
        self._full[:-2], self._full[-2:] = pair.q_rad, pair.width_m / 2
        pin.updateGeometryPlacements(self.robot.model, self._data, self._model, geometry, self._full)
        first, second = (
            (self._model.geometryObjects[index].geometry, np.array(geometry.oMg[index].homogeneous))
            for index in (pair.first, pair.second)
        )
        return first, second

    def _is_thing(self, index: int) -> bool:
        return index >= self._robot_parts

    def own_pairs(self) -> frozenset[frozenset[str]]:
        """Return the checked pairs of the robot's own parts."""
        pairs = self._model.collisionPairs
        return frozenset(
            frozenset((self._names[p.first], self._names[p.second])) for p in pairs if p.second < self._robot_parts
        )

    def _level(self, margins: npt.NDArray[np.float64]) -> tuple[pin.GeometryData, Any]:
        geometry = self._model.createData()
        geometry.setSecurityMargins(self._model, margins)
        return geometry, pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(self.robot.model, self._model, geometry)

    def _placed(self, name: str, thing: Thing) -> pin.GeometryObject:
        if thing.held:
            return self.robot.on_hand(name, thing.shape, thing.pose)
        return pin.GeometryObject(name, 0, 0, pin.SE3(thing.pose), thing.shape)

    def _pairs(self) -> Mask:
        """Return the checked pairs (upper triangle): part and part, part and thing, held object and other things."""
        parts, every = self._robot_parts, len(self._names)
        pairs = np.zeros((every, every), dtype=bool)
        pairs[:parts, :parts] = _own_pairs(tuple(self._names[:parts]), self.robot.last_link)
        for index, thing in enumerate(self._things, start=parts):
            pairs[:parts, index] = [name not in thing.near for name in self._names[:parts]]
            if thing.held:
                pairs[index, parts:] = pairs[parts:, index] = [not other.held for other in self._things]
        return np.triu(pairs, 1)


@cache
def _part_names(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(part_name(name) for name in names)


@cache
def _own_pairs(names: tuple[str, ...], last_link: str) -> Mask:
    apart = _neighbours(last_link)
    return np.array([[a != b and frozenset((a, b)) not in apart for b in names] for a in names])
