"""Stage 4, execute: run the plan, grasp, lift, look again while holding. And afterwards: deliver."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from bus.codes import Code
from bus.errors import CycleFailure, HandFault
from bus.messages import Delivery, Execution, Grasp, HandState, Observation, PickPlan, SegmentName, SegmentRun
from bus.trajectory import TICK_S, Trajectory
from cell.gate import Gate
from config.schema import Station
from drivers.interface import Arm, Hand

DoneT = TypeVar("DoneT")

_WIDTH_SLACK_M = 0.005
"""A measured width may lie so far outside the hand's range; what lies farther no hand has."""


class _Runner:
    """Runs motions one after the other, each through the gate, until one is stopped; keeps what was measured."""

    def __init__(self, arm: Arm, hand: Hand, gate: Gate, widest_m: float) -> None:
        self._arm, self._hand, self._gate, self._widest_m = arm, hand, gate, widest_m
        self.runs: list[SegmentRun] = []
        self.stopped_in: str | None = None

    def move(self, name: str, motion: Callable[[], DoneT]) -> DoneT | None:
        """One motion of arm or hand, called ``name``, when the gate lets it through; a stop before it is kept."""
        if self.stopped_in is not None:
            return None
        with self._gate.motion() as may_begin:
            if may_begin:
                return motion()
        self.stopped_in = name
        return None

    def run(self, name: str, trajectory: Trajectory) -> bool:
        """Play one segment; False when it was stopped, or must not begin."""
        motion = self.move(name, lambda: self._arm.execute(trajectory))
        if motion is None:
            return False
        self.runs.append(SegmentRun.model_validate({"name": name, "motion": motion, "hand": self._read_hand()}))
        if not motion.finished:
            self.stopped_in = name
        return motion.finished

    def _read_hand(self) -> HandState:
        """Raises: HandFault for a width that no hand has."""
        state = self._hand.state()
        if not -_WIDTH_SLACK_M <= state.width_m <= self._widest_m + _WIDTH_SLACK_M:
            raise HandFault(
                f"The hand reports a width of {state.width_m * 1e3:.1f} mm; it opens to {self._widest_m * 1e3:.0f} mm.",
                "Home it, or correct hand.max_width_m.",
            )
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
    """Open, approach, close, lift, hold, and look again from aside.

    Returns:
        What happened, and the second observation (None when stopped before it).
    """
    arm, hand = devices
    runner = _Runner(arm, hand, gate, station.hand.max_width_m)
    grasped: HandState | None = None
    after: Observation | None = None
    runner.move("open", lambda: hand.move(grasp.opening_m, station.hand.speed_m_s))
    if runner.run_part(plan, "reach"):
        grasped = runner.move("grasp", lambda: hand.grasp(station.hand.grasp_force_n, station.hand.speed_m_s))
        if runner.run_part(plan, "carry") and _hold(runner, plan, station):
            after = look()
    execution = Execution(
        runs=tuple(runner.runs),
        grasped=grasped,
        stopped_in=runner.stopped_in,
        after=after.view if after is not None else None,
    )
    return execution, after


def _hold(runner: _Runner, plan: PickPlan, station: Station) -> bool:
    """Stand still for ``verify.hold_s``, in ``verify.samples`` pieces, the hand read after each."""
    ticks = max(1, round(station.verify.hold_s / station.verify.samples / TICK_S))
    still = Trajectory(raw_q_rad=np.repeat(_part(plan, "carry").end_q_rad[None], ticks, axis=0), window=1)
    return all(runner.run("hold", still) for _ in range(station.verify.samples))


def _part(plan: PickPlan, name: SegmentName) -> Trajectory:
    (trajectory,) = (part.trajectory for part in plan.segments if part.name == name)
    return trajectory


def deliver(plan: PickPlan, devices: tuple[Arm, Hand], station: Station, gate: Gate) -> Delivery:
    """Lay what the hand holds into the tray and come back to the capture pose.

    Raises: CycleFailure(STOPPED) when a stop interrupted it.
    """
    arm, hand = devices
    runner = _Runner(arm, hand, gate, station.hand.max_width_m)
    released: HandState | None = None
    if runner.run_part(plan, "place"):
        released = runner.move("release", lambda: hand.move(station.hand.max_width_m, station.hand.speed_m_s))
        runner.run_part(plan, "home")
    if runner.stopped_in is not None:
        raise CycleFailure(Code.STOPPED, f"Stopped during {runner.stopped_in!r} of the delivery.")
    return Delivery(runs=tuple(runner.runs), released=released)
