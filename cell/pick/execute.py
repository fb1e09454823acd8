"""Stage 4, execute: run the plan, grasp, lift, capture again while holding. And afterwards: deliver."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from bus.codes import Code
from bus.errors import CycleFailure, DeviceLost
from bus.messages import Delivery, Execution, Grasp, HandState, Motion, Observation, PickPlan, SegmentName, SegmentRun
from bus.trajectory import TICK_S, Trajectory
from cell.machine.gate import Gate
from cell.pick.fingers import require_at, require_new, require_possible
from config.schema import HandSettings, Station
from drivers.interface import Arm, Hand

DoneT = TypeVar("DoneT")


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

    def run(self, name: str, trajectory: Trajectory) -> bool:
        """Play one segment; False when it was stopped, or may not begin."""
        motion = self.move(name, lambda: self._arm.execute(trajectory))
        if motion is None:
            return False
        _require_measured(motion)
        self.runs.append(SegmentRun.model_validate({"name": name, "motion": motion, "hand": self._read_hand()}))
        if not motion.finished:
            self.stopped_in = name
        return motion.finished

    def open(self, name: str, width_m: float) -> HandState | None:
        """Open the free fingers. Raises: HandFault when they do not reach the width."""
        state = self.move(name, lambda: self._hand.move(width_m, self._limits.max_speed_m_s))
        if state is not None and not self._gate.halted:
            require_at(state, width_m)
        return state

    def grasp(self, force_n: float, speed_m_s: float) -> HandState | None:
        """Close on the object. Raises: HandFault when the hand did not act."""
        before = self._read_hand()
        state = self.move("grasp", lambda: self._hand.grasp(force_n, speed_m_s))
        if state is not None:
            require_possible(state, self._limits.max_width_m)
            require_new(state, before)
        return state

    def _read_hand(self) -> HandState:
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
    station: Station,
    gate: Gate,
) -> tuple[Execution, Observation | None]:
    """Open, approach, close, lift, hold, and capture again from the side.

    Args:
        look: captures the second observation.
        gate: every motion passes it.

    Returns:
        The execution, and the second observation (None when stopped before it).
    """
    arm, hand = devices
    runner = _Runner(arm, hand, gate, station.hand)
    grasped: HandState | None = None
    after: Observation | None = None
    runner.open("open", grasp.opening_m)
    if runner.run_part(plan, "reach"):
        grasped = runner.grasp(station.hand.grasp_force_n, station.hand.speed_m_s)
        if runner.run_part(plan, "carry") and _hold(runner, plan, station):
            after = look()
    execution = Execution(
        runs=tuple(runner.runs),
        grasped=grasped,
        stopped_in=runner.stopped_in,
        after=after.view if after is not None else None,
    )
    return execution, after


def _require_measured(motion: Motion) -> None:
    """Raises: DeviceLost when the arm's measurements are not finite."""
    if not all(np.isfinite(measured).all() for measured in (motion.q_rad, motion.dq_rad_s, motion.tau_ext_nm)):
        raise DeviceLost("The arm measured what is not a finite number.", "Restart its node.")


def _hold(runner: _Runner, plan: PickPlan, station: Station) -> bool:
    """Stand still for ``verify.hold_s``, in ``verify.samples`` pieces; the hand is read after each."""
    ticks = max(1, round(station.verify.hold_s / station.verify.samples / TICK_S))
    still = Trajectory(raw_q_rad=np.repeat(_part(plan, "carry").end_q_rad[None], ticks, axis=0), window=1)
    return all(runner.run("hold", still) for _ in range(station.verify.samples))


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
        released = runner.open("release", _release_m(grasp, runner.runs[-1].hand.width_m, station.hand))
        runner.run_part(plan, "home")
    if runner.stopped_in is not None:
        raise CycleFailure(Code.STOPPED, f"Stopped during {runner.stopped_in!r} of the delivery.")
    return Delivery(runs=tuple(runner.runs), released=released)
