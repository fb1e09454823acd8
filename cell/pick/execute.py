"""Stage 4, execute: run the plan, grasp, lift, capture again while holding. And afterwards: deliver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from bus.codes import Code
from bus.errors import BusError, CycleFailure, DeviceLost, DriverError
from bus.messages import (
    Contact,
    Delivery,
    Execution,
    Grasp,
    HandState,
    Motion,
    Observation,
    PickPlan,
    SegmentName,
    SegmentRun,
)
from bus.trajectory import TICK_S, Trajectory
from cell.machine.gate import Gate
from cell.pick.fingers import require_at, require_new, require_possible
from cell.pick.opening import Opening, opened_meanwhile
from cell.pick.touching import Thing, WayUp, contact_of, guarded
from cell.pick.verify import is_clear
from cell.pick.watching import watched
from config.devices import HandSettings
from config.schema import Station
from drivers.interface import Arm, Hand
from planning.feeling import way_back
from planning.robot import Robot

DoneT = TypeVar("DoneT")
_UNKNOWN = Thing()
_SHORTEST_PIECE_S = 0.1
"""Of a hold: a real hand does not tell its width more often."""


class _Runner:
    """Runs motions one after the other, each through the gate, until one is stopped; keeps the measurements."""

    def __init__(self, arm: Arm, hand: Hand, gate: Gate, limits: HandSettings) -> None:
        self._arm, self._hand, self._gate, self._limits = arm, hand, gate, limits
        self.runs: list[SegmentRun] = []
        self.stopped_in: str | None = None

    def move(self, name: str, motion: Callable[[], DoneT]) -> DoneT | None:
        """Run one motion of arm or hand, called ``name``, when the gate lets it pass; a stop before it is kept."""
        if self.stopped_in is not None:
            return None
        with self._gate.motion() as may_begin:
            if may_begin:
                return motion()
        self.stopped_in = name
        return None

    def carry_part(self, plan: PickPlan, name: SegmentName) -> bool:
        """Play a way with the object in hand, and watch the hand meanwhile; as `run`."""
        trajectory = _part(plan, name)
        with watched(self.read_hand) as meanwhile:
            motion = self.move(name, lambda: self._arm.execute(trajectory))
        return self._keep(name, motion, meanwhile)

    def run(self, name: str, trajectory: Trajectory) -> bool:
        """Play one segment; False when it was stopped, or may not begin. A contact is no stop."""
        return self._keep(name, self.move(name, lambda: self._arm.execute(trajectory)))

    def _keep(self, name: str, motion: Motion | None, meanwhile: Sequence[HandState] = ()) -> bool:
        if motion is None:
            return False
        _require_measured(motion)
        hand = {"hand": self.read_hand(), "hand_meanwhile": tuple(meanwhile)}
        self.runs.append(SegmentRun.model_validate({"name": name, "motion": motion, **hand}))
        if not motion.finished and motion.contact_n is None:
            self.stopped_in = name
        return self.stopped_in is None

    def reach(self, trajectory: Trajectory, width_m: float) -> bool:
        """Reach while the hand opens: the arm waits before its approach line (``waits_at``) until it is open.

        Raises: HandFault when it does not open; the arm has not gone on then.
        """
        opening = Opening(self._arm, self._gate, lambda: self._opened(width_m))
        if not opening.begin():
            self.stopped_in = "open"
            return False
        try:
            arrived = self.run("reach", trajectory)
        except (DriverError, BusError):
            self._hand.stop()
            raise
        finally:
            opening.wait()
        opening.require_open()
        if arrived:
            require_at(self.runs[-1].hand, width_m)
        return arrived

    def release(self, width_m: float) -> HandState | None:
        """Let go of what is held. Raises: HandFault when the fingers do not reach the width."""
        return self.move("release", lambda: self._opened(width_m))

    def go_home(self, trajectory: Trajectory) -> bool:
        """Play the way home, which is free at any width, while the hand opens for the next pick; as `run`.

        Raises: HandFault when the hand does not open.
        """
        with opened_meanwhile(self._gate, lambda: self._opened(self._limits.max_width_m)):
            return self.run("home", trajectory)

    def _opened(self, width_m: float) -> HandState | None:
        """Move the free fingers to a width; None when stopped. Raises: HandFault when they do not get there."""
        state = self._hand.move(width_m, self._limits.max_speed_m_s)
        if self._gate.halted:
            return None
        require_at(state, width_m)
        return state

    def grasp(self, force_n: float, speed_m_s: float) -> HandState | None:
        """Close on the object. Raises: HandFault when the hand did not act."""
        before = self.read_hand()
        state = self.move("grasp", lambda: self._hand.grasp(force_n, speed_m_s))
        if state is not None:
            require_possible(state, self._limits.max_width_m)
            require_new(state, before)
        return state

    def read_hand(self) -> HandState:
        """The hand's state. Raises: HandFault for an impossible width."""
        state = self._hand.state()
        require_possible(state, self._limits.max_width_m)
        return state

    def run_part(self, plan: PickPlan, name: SegmentName) -> bool:
        return self.run(name, _part(plan, name))


def execute(
    plan: PickPlan,
    grasp: Grasp,
    devices: tuple[Arm, Hand],
    look: Callable[[], Observation],
    robot: Robot,
    station: Station,
    gate: Gate,
    thing: Thing = _UNKNOWN,
) -> tuple[Execution, Observation | None]:
    """Reach and open on the way, close, lift, hold, and capture again from the side, where the station asks for it.

    An arm that meets something on its approach closes the fingers there, where they still reach the thing; or it goes
    back the way it came, to where it began.

    Args:
        look: captures the second observation.
        gate: every motion passes it.
        thing: what is grasped.

    Returns:
        The execution, and the second observation (None when stopped before it, or when width and load are clear).
    """
    arm, hand = devices
    runner = _Runner(arm, hand, gate, station.hand)
    grasped: HandState | None = None
    after: Observation | None = None
    began = runner.read_hand()
    reach = guarded(robot, station, _part(plan, "reach"))
    contact: Contact | None = None
    if runner.reach(reach, grasp.opening_m):
        contact = contact_of(robot, runner.runs[-1].motion, reach, thing)
        down, way_up = runner.runs[-1].motion, WayUp(robot, station, thing, grasp)
        contact = contact_of(robot, down, reach, thing)
        planned_up = plan if contact is None else way_up.joined_to(plan, down, contact)
        if planned_up is None:
            runner.run("retreat", way_back(station, down.commanded_q_rad))
        else:
            grasped, after = _pick_up(runner, planned_up, grasp, look, robot, station, thing)
    execution = Execution(
        runs=tuple(runner.runs),
        grasped=grasped,
        stopped_in=runner.stopped_in,
        after=after.view if after is not None else None,
        began=began,
        contact=contact,
    )
    return execution, after


def _pick_up(
    runner: _Runner,
    plan: PickPlan,
    grasp: Grasp,
    look: Callable[[], Observation],
    robot: Robot,
    station: Station,
    thing: Thing,
) -> tuple[HandState | None, Observation | None]:
    """Close, lift, hold, and look again; returns the hand right after closing, and the second observation."""
    grasped = runner.grasp(station.hand.grasp_force_n, station.hand.speed_m_s)
    after: Observation | None = None
    if runner.carry_part(plan, "carry") and _hold(runner, plan, station):
        assert grasped is not None, "a hand that was stopped carries nothing"
        if not any(part.name == "aside" for part in plan.segments):
            after = look()
        elif not is_clear(grasp, grasped, runner.runs, robot, station, thing.one) and runner.carry_part(plan, "aside"):
            after = look()
            runner.carry_part(plan, "return")
    return grasped, after


def _require_measured(motion: Motion) -> None:
    """Raises: DeviceLost when the arm's measurements are not finite."""
    if not all(np.isfinite(measured).all() for measured in (motion.q_rad, motion.dq_rad_s, motion.tau_ext_nm)):
        raise DeviceLost("The arm measured what is not a finite number.", "Restart its node.")


def _hold(runner: _Runner, plan: PickPlan, station: Station) -> bool:
    """Stand still for ``verify.hold_s``; the hand is read after each of its pieces, ``verify.samples`` or fewer."""
    need = station.verify
    pieces = max(1, min(need.samples, round(need.hold_s / _SHORTEST_PIECE_S)))
    ticks = max(1, round(need.hold_s / pieces / TICK_S))
    still = Trajectory(raw_q_rad=np.repeat(_part(plan, "carry").end_q_rad[None], ticks, axis=0), window=1)
    return all(runner.run("hold", still) for _ in range(pieces))


def _part(plan: PickPlan, name: SegmentName) -> Trajectory:
    (trajectory,) = (part.trajectory for part in plan.segments if part.name == name)
    return trajectory


def _release_m(grasp: Grasp, held_m: float, hand: HandSettings) -> float:
    """Opening that lets go of what is held at ``held_m``: the fingers must leave what they came around."""
    return min(hand.max_width_m, max(grasp.opening_m, held_m + hand.release_margin_m))


def deliver(plan: PickPlan, grasp: Grasp, devices: tuple[Arm, Hand], station: Station, gate: Gate) -> Delivery:
    """Lay the held object into the tray and return to the capture pose.

    Raises: CycleFailure(STOPPED) when a stop interrupted it.
    """
    arm, hand = devices
    runner = _Runner(arm, hand, gate, station.hand)
    released: HandState | None = None
    if runner.run_part(plan, "place"):
        released = runner.release(_release_m(grasp, runner.runs[-1].hand.width_m, station.hand))
        runner.go_home(_part(plan, "home"))
    if runner.stopped_in is not None:
        raise CycleFailure(Code.STOPPED, f"Stopped during {runner.stopped_in!r} of the delivery.")
    return Delivery(runs=tuple(runner.runs), released=released)
