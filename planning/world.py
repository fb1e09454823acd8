"""One collision world: the robot's parts, what stands around it, and how near each pair may come (Pinocchio, coal)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import coal
import numpy as np
import pinocchio as pin

from bus.arrays import Joints, Transform
from planning.robot import Robot, part_name

FINGERS = frozenset({"left finger", "right finger"})
_HAND = FINGERS | {"hand", "camera", "link 7"}
_NEIGHBOURS = {
    frozenset(pair)
    for pair in (
        *((f"link {i}", f"link {i + 1}") for i in range(7)),
        ("link 5", "link 7"),
        *combinations(sorted(_HAND), 2),
    )
}
"""Parts that always overlap or cannot reach each other; tests/planning/test_world.py measures both."""


@dataclass(frozen=True)
class Thing:
    """Something that is not the robot.

    Attributes:
        name: in people's words. ``shape``: its geometry; ``pose``: in ``base``, or in the hand if it is ``held``.
        near: parts of the robot that may touch it.
    """

    name: str
    shape: coal.CollisionGeometry
    pose: Transform = field(default_factory=lambda: np.eye(4))
    near: frozenset[str] = frozenset()
    held: bool = False


def held_thing(shape: coal.CollisionGeometry, hand_from_shape: Transform) -> Thing:
    """What the hand holds: it moves along, and touches the hand."""
    return Thing("held object", shape, hand_from_shape, _HAND, held=True)


class World:
    """Answers what touches what in one configuration. Not thread-safe.

    Args:
        parts: the robot's, `Robot.hulls` or `Robot.meshes`.
        margin_m: how near anything may come to anything.
        finger_margin_m: how near the fingers may come to things, among which they work.
    """

    def __init__(
        self,
        robot: Robot,
        parts: Sequence[pin.GeometryObject],
        things: Iterable[Thing],
        *,
        margin_m: float,
        finger_margin_m: float,
    ) -> None:
        self._robot = robot
        self._things = tuple(things)
        self._names = [part_name(part.name) for part in parts] + [thing.name for thing in self._things]
        self._robot_parts = len(parts)
        self._model = pin.GeometryModel()
        for part in parts:
            self._model.addGeometryObject(part)
        for number, thing in enumerate(self._things):
            self._model.addGeometryObject(self._placed(f"thing {number}", thing))
        for pair in self._pairs():
            self._model.addCollisionPair(pin.CollisionPair(*pair))
        self._geometry = self._model.createData()
        self._data = robot.model.createData()
        self._full = np.zeros(robot.model.nq)
        for pair, request in zip(self._model.collisionPairs, self._geometry.collisionRequests, strict=True):
            fingers = self._names[pair.first] in FINGERS and pair.second >= self._robot_parts
            request.security_margin = finger_margin_m if fingers else margin_m
        self._manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(robot.model, self._model, self._geometry)

    def touch(self, q_rad: Joints, width_m: float) -> str | None:
        """What comes nearer than its margin, e.g. ``right finger touches table``; None if nothing does.

        Args:
            width_m: opening of the hand.
        """
        self._full[:7], self._full[7:] = q_rad, width_m / 2
        pin.updateGeometryPlacements(self._robot.model, self._data, self._model, self._geometry, self._full)
        self._manager.update(False)
        callback = pin.CollisionCallBackDefault(self._model, self._geometry, True)
        self._manager.collide(callback)
        if not callback.collision:
            return None
        pair = self._model.collisionPairs[callback.collisionPairIndex]
        return f"{self._names[pair.first]} touches {self._names[pair.second]}"

    def own_pairs(self) -> frozenset[frozenset[str]]:
        """The checked pairs of the robot's own parts."""
        pairs = self._model.collisionPairs
        return frozenset(
            frozenset((self._names[p.first], self._names[p.second])) for p in pairs if p.second < self._robot_parts
        )

    def _placed(self, name: str, thing: Thing) -> pin.GeometryObject:
        if thing.held:
            return self._robot.on_hand(name, thing.shape, thing.pose)
        return pin.GeometryObject(name, 0, 0, pin.SE3(thing.pose), thing.shape)

    def _pairs(self) -> list[tuple[int, int]]:
        """Part against part, part against thing, and what is held against the other things."""
        parts, things = range(self._robot_parts), range(self._robot_parts, len(self._names))
        own = [
            (a, b)
            for a, b in combinations(parts, 2)
            if self._names[a] != self._names[b] and frozenset((self._names[a], self._names[b])) not in _NEIGHBOURS
        ]
        around = [(a, b) for a, b in product(parts, things) if self._names[a] not in self._thing(b).near]
        held = [(a, b) for a, b in product(things, things) if self._thing(a).held and not self._thing(b).held]
        return own + around + held

    def _thing(self, index: int) -> Thing:
        return self._things[index - self._robot_parts]
