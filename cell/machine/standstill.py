"""Hold, resume and stop: motion comes to rest, confirmed by the measured velocity and not by a reply."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bus.clock import DeadlineClock
from bus.codes import Code
from bus.errors import CycleFailure, MotionRefused
from bus.messages import ArmMode, ArmState
from cell.machine.gate import Gate
from drivers.interface import Arm, Hand

_REST_RAD_S = 0.1
"""Speed limit of an arm at rest: the FR3's measured velocity chatters by up to 0.08 rad/s at standstill."""
_LOOK_S = 0.01
_ENDING_S = 1.0
"""Longest end of a motion after its arm reported that nothing is held."""


def hold(arm: Arm, gate: Gate, limit_s: float, clock: DeadlineClock) -> None:
    """Hold all motion, and confirm that the arm rests; a stop ends the wait.

    The fingers cannot be held: their motion is waited for.

    Args:
        limit_s: longest time until the arm rests.

    Raises: CycleFailure when the arm does not rest in time.
    """
    give_up_s = clock.now_s() + limit_s
    at_rest = 0  # consecutive readings
    while at_rest < 2 and not gate.halted:  # a motion may just have been on its way: hold again
        if clock.now_s() > give_up_s:
            raise CycleFailure(
                Code.INTERNAL, f"The cell still moves {limit_s:.0f} s after the hold.{clock.busy_note()}"
            )
        arm.hold()
        under_way, state = gate.under_way, arm.state()
        held = under_way == 0 or (under_way == 1 and state.mode is ArmMode.MOVE)
        at_rest = at_rest + 1 if held and _speed_rad_s(state) <= _REST_RAD_S else 0
        time.sleep(_LOOK_S)


def unhold(arm: Arm, gate: Gate, clock: DeadlineClock, ending_s: float = _ENDING_S) -> None:
    """Resume the held motion, and let waiting motions begin.

    Args:
        clock: the clock of ``ending_s``.
        ending_s: how long a motion may take to be over once its arm holds nothing.

    Raises: MotionRefused, BusError.
    """
    if gate.is_moving:
        try:
            arm.resume()
        except MotionRefused:  # the hold came at the motion's very end: it is over now
            if not clock.wait_for(gate.wait_still, ending_s):
                raise
    gate.release()


def stop(
    arm: Arm, hand: Hand, gate: Gate, no_action_running: Callable[[float], bool], limit_s: float, clock: DeadlineClock
) -> None:
    """Stop until no action runs, then confirm that the arm rests.

    Args:
        no_action_running: waits up to a time [s]; True when no other action runs.
        limit_s: longest time for all of it.

    Raises: CycleFailure when an action still runs, or the arm does not rest, in time.
    """
    gate.halt()
    give_up_s = clock.now_s() + limit_s
    arm.stop()
    hand.stop()
    while not no_action_running(0.05):  # a motion may just have been on its way: stop again
        arm.stop()
        hand.stop()
        if clock.now_s() > give_up_s:
            raise CycleFailure(
                Code.INTERNAL, f"The cycle still runs {limit_s:.0f} s after the stop.{clock.busy_note()}"
            )
    while not (speed_rad_s := _speed_rad_s(arm.state())) <= _REST_RAD_S:  # written so that NaN fails
        if clock.now_s() > give_up_s:
            raise CycleFailure(Code.INTERNAL, f"The arm still moves at {speed_rad_s:.2f} rad/s after the stop.")
        time.sleep(_LOOK_S)


def _speed_rad_s(state: ArmState) -> float:
    """Speed of the fastest joint."""
    return float(np.abs(state.dq_rad_s).max())
