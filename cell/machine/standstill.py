"""Hold, go on, stop: what moves comes to rest, confirmed by the measured velocity, never by a reply."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bus.codes import Code
from bus.errors import CycleFailure, MotionRefused
from bus.messages import ArmMode, ArmState
from cell.machine.gate import Gate
from drivers.interface import Arm, Hand

_REST_RAD_S = 0.1
"""Below this the arm rests: the FR3's measured velocity chatters by up to 0.08 rad/s at standstill."""
_LOOK_S = 0.01
_ENDING_S = 1.0
"""How long a motion may take to be over once its arm says that nothing is held."""


def hold(arm: Arm, gate: Gate, patience_s: float) -> None:
    """Hold what moves, and confirm that the arm rests; a stop ends the wait.

    The fingers cannot be held: their motion is waited for. Raises: CycleFailure when the arm does not rest in time.
    """
    give_up_s = time.monotonic() + patience_s
    at_rest = 0  # readings running
    while at_rest < 2 and not gate.halted:  # the first may be of a motion that was just on its way: hold again
        if time.monotonic() > give_up_s:
            raise CycleFailure(Code.INTERNAL, f"The cell still moves {patience_s:.0f} s after the hold.")
        arm.hold()
        is_moving, state = gate.is_moving, arm.state()
        held = not is_moving or state.mode is ArmMode.MOVE
        at_rest = at_rest + 1 if held and _speed_rad_s(state) <= _REST_RAD_S else 0
        time.sleep(_LOOK_S)


def unhold(arm: Arm, gate: Gate, ending_s: float = _ENDING_S) -> None:
    """Let the held motion go on, and what waits at the gate begin.

    A motion of which the arm says that nothing is held has ``ending_s`` to be over. Raises: MotionRefused, BusError.
    """
    if gate.is_moving:
        try:
            arm.resume()
        except MotionRefused:  # the hold came at its very end: then it is over now
            if not gate.wait_still(ending_s):
                raise
    gate.let_go()


def stop(arm: Arm, hand: Hand, gate: Gate, is_quiet: Callable[[float], bool], patience_s: float) -> None:
    """Stop until ``is_quiet`` (no work runs), then confirm that the arm rests. Raises: CycleFailure if it does not."""
    gate.halt()
    give_up_s = time.monotonic() + patience_s
    arm.stop()
    hand.stop()
    while not is_quiet(0.05):  # a motion may just have been on its way: stop again
        arm.stop()
        hand.stop()
        if time.monotonic() > give_up_s:
            raise CycleFailure(Code.INTERNAL, f"The cycle still runs {patience_s:.0f} s after the stop.")
    while not (speed_rad_s := _speed_rad_s(arm.state())) <= _REST_RAD_S:  # nan is no rest
        if time.monotonic() > give_up_s:
            raise CycleFailure(Code.INTERNAL, f"The arm still moves at {speed_rad_s:.2f} rad/s after the stop.")
        time.sleep(_LOOK_S)


def _speed_rad_s(state: ArmState) -> float:
    """Of the fastest joint."""
    return float(np.abs(state.dq_rad_s).max())
