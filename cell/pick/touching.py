"""The end of an approach on which the arm meets something: the fingers close there, or it goes back as it came."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bus.errors import CycleFailure
from bus.messages import Contact, Grasp, Motion, PickPlan
from bus.trajectory import Trajectory
from cell.pick.several import OneThing
from config.schema import Station
from planning.feeling import closes_within_m, guard, joined, lifted_at
from planning.pregrasp import approach_begins
from planning.robot import Robot
from planning.scene import Scene


@dataclass(frozen=True)
class Thing:
    """The thing to be grasped, as far as it matters when the arm meets something before.

    Attributes:
        top_m: its highest point in ``base``; None = unknown.
        scene: gives the scene with it as the target, which judges the way up with it from elsewhere than was planned;
            None = there is no other way up.
        one: measures what it alone explains of load and width; None = not known.
    """

    top_m: float | None = None
    scene: Callable[[], Scene] | None = None
    one: Callable[[], OneThing] | None = None


def guarded(robot: Robot, station: Station, reach: Trajectory) -> Trajectory:
    """Return ``reach`` as it is played: the arm waits before its approach line, and feels on it if the station says."""
    begins_at = approach_begins(robot, reach, station.planning.approach_m)
    limit_n = station.execute.contact_n
    felt = guard(robot, reach, begins_at, limit_n) if limit_n else None
    return reach.model_copy(update={"waits_at": begins_at, "guard": felt})


def contact_of(robot: Robot, motion: Motion, reach: Trajectory, thing: Thing) -> Contact | None:
    """Return what the arm met on ``reach``, or None."""
    if motion.contact_n is None:
        return None
    base_from_tcp = robot.base_from_tcp(motion.q_rad[-1])
    end_m = robot.base_from_tcp(reach.end_q_rad)[:3, 3]
    return Contact(
        base_from_tcp=base_from_tcp,
        force_n=motion.contact_n,
        remaining_m=float(np.linalg.norm(end_m - base_from_tcp[:3, 3])),
        closes_within_m=closes_within_m(robot, reach.end_q_rad, thing.top_m),
    )


class WayUp:
    """Makes the way up with a thing that is grasped short of where it was planned."""

    def __init__(self, robot: Robot, station: Station, thing: Thing, grasp: Grasp) -> None:
        self._robot, self._station, self._thing, self._grasp = robot, station, thing, grasp

    def joined_to(self, plan: PickPlan, motion: Motion, contact: Contact) -> PickPlan | None:
        """Return ``plan`` with its carry from where the arm rests; None when the fingers are not to close there.

        Args:
            motion: the one that met something, ``contact``.
        """
        if contact.remaining_m > contact.closes_within_m or self._thing.scene is None:
            return None
        parts = {part.name: part for part in plan.segments}
        try:
            carry = joined(self._robot, self._station, parts["carry"].trajectory, motion.commanded_q_rad[-1])
        except CycleFailure:  # within the limits there is no such way
            return None
        if self._touches(self._thing.scene(), carry, parts["place"].trajectory, contact):
            return None
        parts["carry"] = parts["carry"].model_copy(update={"trajectory": carry})
        return plan.model_copy(update={"segments": tuple(parts.values())})

    def _touches(self, scene: Scene, carry: Trajectory, place: Trajectory, contact: Contact) -> bool:
        """Whether hand or thing, which hangs lower than was planned, would touch anything on the ways with it."""
        width_m, up, down = self._grasp.width_m, carry.filtered(), place.filtered()
        free_at = lifted_at(self._robot, self._station, up)
        holding = scene.holding(contact.base_from_tcp)
        judged = ((scene.empty(), up[: free_at + 1]), (holding, up[free_at:]), (holding, down))
        return any(one.gate(commands, width_m) is not None for one, commands in judged)
