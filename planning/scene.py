"""The obstacles of one pick, and collision checks of paths among them. Frames: docs/frames.md.

Known boxes come from the station, other obstacles from the camera; a held object moves with the hand. Plans are made
with the convex hulls of the robot's parts; `Scene.gate` checks them with other shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from functools import cached_property

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import Joints, JointSamples, Transform
from bus.cancel import Cancel
from bus.transforms import from_translation, inverse
from config.scene import Box, scene_boxes
from config.schema import Station
from planning.height_field import KNOWN_M, ObservedHeightField, Sight, observed_field, solid, subsample
from planning.own_body import on_robot
from planning.robot import HAND_FROM_TCP, Robot
from planning.sweep import WIDE_MARGINS_M, first_collision, is_free
from planning.travel import Travel
from planning.world import FINGERS, Collision, Effort, Thing, World, held_thing

Array = npt.NDArray[np.float64]
Width = float | None
"""Opening of the hand [m] on a way; None = any from closed to fully open, so that the fingers may move meanwhile."""

FINGER_CLEARANCE_M = 0.002
"""Clearance of the fingers: smaller than the rest's, because they work between objects."""
TARGET = "the target"
_FEWEST_POINTS = 20
_GATE_TICKS = 8
_GATE_MARGIN_M = 0.001


BESIDE_M, NEAR_M = WIDE_MARGINS_M
"""How far `Scene.is_near` may ask."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The obstacles of one pick.

    Attributes:
        station: gives clearance, hand and motion settings.
        boxes: the known boxes; the first is the table.
        field: the observed obstacles besides; None = none.
        target: the points (n, 3) [m] of the object to be grasped in ``base``; only the fingers may touch it.
        keeps_off: the fingers may not touch it either.
        held: the object in the hand.
        fixed: known things of other shapes than the boxes, or turned.
        cancel: once set, every check raises CycleFailure(STOPPED), which ends all planning with this scene.
        effort: of all checks in this scene, and in those made of it.
    """

    robot: Robot
    station: Station
    boxes: tuple[Box, ...]
    field: ObservedHeightField | None = None
    target: Array | None = None
    keeps_off: bool = False
    held: Thing | None = None
    fixed: tuple[Thing, ...] = ()
    cancel: Cancel = dataclass_field(default_factory=Cancel)
    effort: Effort = dataclass_field(default_factory=Effort)

    @classmethod
    def of(
        cls,
        robot: Robot,
        station: Station,
        *sights: Sight,
        boxes: Sequence[Box] | None = None,
        cancel: Cancel | None = None,
    ) -> Scene:
        """Make a scene of the station's boxes (or of ``boxes``) and of the obstacles that were observed among them."""
        known = scene_boxes(station.scene) if boxes is None else tuple(boxes)
        cancel = cancel or Cancel()
        if not sights:
            return cls(robot, station, known, cancel=cancel)
        target = np.concatenate([sight.points_base[sight.target].astype(float) for sight in sights])
        target = subsample(target[np.isfinite(target[:, 2])])
        field = observed_field([_without_robot(sight, robot) for sight in sights], known)
        seen = target if len(target) >= _FEWEST_POINTS else None
        return cls(robot, station, known, field, seen, cancel=cancel)

    def holding(self, base_from_tcp: Transform) -> Scene:
        """Return the scene with the target hanging in the hand, as it lay with the tcp at ``base_from_tcp`` (4, 4)."""
        if self.target is None:
            return self
        held = held_thing(self._target_solid, HAND_FROM_TCP @ inverse(base_from_tcp), self.robot.last_link)
        return replace(self, target=None, held=held)

    def empty(self) -> Scene:
        """Return the scene without the target, neither in the hand nor on the table."""
        return self._without_target

    def on_the_way(self) -> Scene:
        """Return the scene up to the approach line: there the fingers may not touch the target either."""
        return self._kept_off

    @cached_property
    def _kept_off(self) -> Scene:
        return self if self.target is None else replace(self, keeps_off=True)

    @cached_property
    def _without_target(self) -> Scene:
        return self if self.target is None and self.held is None else replace(self, target=None, held=None)

    def collision(self, q_rad: Joints, width_m: Width) -> Collision | None:
        """Return a pair that is nearer than its clearance in one configuration (joints,), or None.

        Args:
            width_m: opening of the hand; None = any, it may move meanwhile.

        Raises:
            CycleFailure: STOPPED once `cancel` is set.
        """
        self.cancel.raise_if_set("plan")
        return self._planned_at(width_m).collision(q_rad, width_m or 0.0)

    def first_collision(self, path_rad: JointSamples, width_m: Width) -> Collision | None:
        """Return the first collision on the polyline ``path_rad`` (n, joints), or None.

        Between checks no point of the robot moves farther than the margin that the checks found free, so that 2.5 mm
        remain everywhere on the way (0.5 mm below the fingers).

        Args:
            width_m: opening of the hand; None = any, it may move meanwhile.

        Raises:
            CycleFailure: STOPPED once `cancel` is set.
        """
        return first_collision(self._planned_at(width_m), path_rad, width_m or 0.0, self.cancel)

    def is_line_free(self, q_from_rad: Joints, q_to_rad: Joints, width_m: Width) -> bool:
        """Whether the straight joint line between two configurations (joints,) is free, as in `first_collision`.

        It takes fewer checks, because it bounds the movement more tightly and narrows margins step by step; it does not
        say what is in the way.

        Args:
            width_m: opening of the hand; None = any, it may move meanwhile.

        Raises:
            CycleFailure: STOPPED once `cancel` is set.
        """
        self.cancel.raise_if_set("plan")
        return is_free(self._planned_at(width_m), self._travel, q_from_rad, q_to_rad, width_m or 0.0)

    def is_near(self, q_rad: Joints, width_m: float, within_m: float = NEAR_M) -> bool:
        """Whether in one configuration (joints,) anything is within `NEAR_M` or `BESIDE_M` of what it may not touch."""
        return self._planned.collision(q_rad, width_m, wide=WIDE_MARGINS_M.index(within_m)) is not None

    @property
    def checks(self) -> int:
        """Number of configurations checked so far."""
        return self._planned.checks + self._planned_at_any_width.checks

    def gate(self, commands_rad: JointSamples, width_m: Width) -> Collision | None:
        """Check 1 kHz commands (n, joints) last of all, with other shapes than they were planned with.

        It uses the exact meshes instead of their hulls and the observed points instead of the field, every 8 ms.

        Args:
            width_m: opening of the hand; None = any, it may move meanwhile.

        Returns:
            The first collision, or None.

        Raises:
            CycleFailure: STOPPED once `cancel` is set.
        """
        world = self._exact if width_m is not None else self._exact_at_any_width
        for q in np.concatenate([commands_rad[::_GATE_TICKS], commands_rad[-1:]]):
            self.cancel.raise_if_set("plan")
            collision = world.collision(q, width_m or 0.0)
            if collision is not None:
                return collision
        return None

    # --- worlds -------------------------------------------------------------------------------------------------------

    def _planned_at(self, width_m: Width) -> World:
        return self._planned if width_m is not None else self._planned_at_any_width

    @cached_property
    def _planned(self) -> World:
        return self._planned_with(self.robot.hulls)

    @cached_property
    def _planned_at_any_width(self) -> World:
        return self._planned_with(self.robot.hulls_at_any_width)

    def _planned_with(self, parts: Sequence[pin.GeometryObject]) -> World:
        clearance_m = self.station.planning.clearance_m
        finger_m = min(clearance_m, FINGER_CLEARANCE_M)
        return World(
            self.robot,
            parts,
            self._things,
            margin_m=clearance_m,
            finger_margin_m=finger_m,
            wide_margins_m=WIDE_MARGINS_M,
            effort=self.effort,
        )

    @cached_property
    def _travel(self) -> Travel:
        return Travel(self.robot, self.held)

    @cached_property
    def _exact(self) -> World:
        return self._exact_with(self.robot.meshes)

    @cached_property
    def _exact_at_any_width(self) -> World:
        return self._exact_with(self.robot.meshes_at_any_width)

    def _exact_with(self, parts: Sequence[pin.GeometryObject]) -> World:
        things = self._known
        if self.field is not None:
            things += (self.field.points_thing,)
        if self.held is not None:
            things += (self.held,)
        return World(self.robot, parts, things, margin_m=_GATE_MARGIN_M, finger_margin_m=0.0, effort=self.effort)

    @property
    def _known(self) -> tuple[Thing, ...]:
        near_table = frozenset({"link 0"})  # the base stands on it
        boxes = tuple(
            Thing(
                box.name,
                coal.Box(*box.size_m),
                from_translation(box.center_m),
                near_table if box is self.boxes[0] else frozenset(),
            )
            for box in self.boxes
        )
        return (*boxes, *self.fixed)

    @cached_property
    def _things(self) -> tuple[Thing, ...]:
        things = self._known
        if self.field is not None:
            things += (self.field.thing,)
        if self.target is not None:
            near = frozenset[str]() if self.keeps_off else FINGERS
            things += (Thing(TARGET, self._target_solid, near=near),)
        if self.held is not None:
            things += (self.held,)
        return things

    @cached_property
    def _target_solid(self) -> coal.CollisionGeometry:
        """The target, extended down to just above the table on which it stood."""
        assert self.target is not None
        table = self.boxes[0]
        floor_m = table.center_m[2] + table.size_m[2] / 2 + self.station.planning.clearance_m + 1e-3
        return solid(self.target, floor_m)


def _without_robot(sight: Sight, robot: Robot) -> Sight:
    """The sight with the robot's own points infinite, like those of the target: they hide nothing."""
    if sight.q_rad is None:
        return sight
    own = sight.points_base[..., 2] > robot.station.scene.table.top_m + KNOWN_M  # what is lower is the table
    own[own] = on_robot(robot, sight.q_rad, sight.points_base[own])
    return replace(sight, points_base=np.where(own[..., None], np.float32(np.inf), sight.points_base))
