"""The resetting action: a self-check, then the arm to the capture pose with an open hand.

A hand that may hold something lets go of it first, where the arm rests: an unknown thing is not carried through the
air, nor does it fall from where the arm looks.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from bus.arrays import Joints
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import ArmMode, HandState
from cell.daemon.grip import Grip
from cell.machine.gate import Gate
from cell.pick.equipment import Equipment
from cell.pick.fingers import is_at, require_at
from config.clock import clock_of
from logs.mcap.recorder import ensure_space
from planning.motion import move
from planning.scene import Scene

_AT_CAPTURE_RAD = 5e-3
"""An arm that rests so near to the capture pose is there: it creeps the rest, and where it looks from is measured."""

DoneT = TypeVar("DoneT")


def reset(e: Equipment, grip: Grip, gate: Gate, nodes_alive: set[str], *, goes_on: bool = False) -> None:
    """Prepare the cell for a cycle: self-check, let go of what the hand may hold, move to the capture pose, open.

    Args:
        grip: knows whether the hand may hold something.
        gate: every motion passes it.
        nodes_alive: names of the nodes that are up.
        goes_on: a pick has just ended well, and another of the same command follows. A hand that it left open does not
            move, and no frame is asked for: the capture that comes next refuses an old one, too.

    Raises: CycleFailure, DriverError, RecordingError.
    """
    missing = set(e.station.nodes) - nodes_alive
    if missing:
        raise CycleFailure(Code.NODE_LOST, f"These nodes are not up: {', '.join(sorted(missing))}.")
    ensure_space(e.station.recording.folder, e.station.recording.min_free_mb)
    state, hand = e.arm.state(), e.hand.state()
    if state.mode is not ArmMode.IDLE:
        raise CycleFailure(Code.ARM_REFLEX, f"The arm is in mode {state.mode.value!r}, not idle.")
    was_homed = hand.is_homed
    if not was_homed:
        hand = _move(gate, e.hand.home)
    let_go_m = grip.let_go_m(hand.width_m)
    if let_go_m is not None:
        hand = _open(e, gate, let_go_m)
    _to_capture_pose(e, gate, state.q_rad)
    widest_m = e.station.hand.max_width_m
    if not (goes_on and was_homed and is_at(hand, widest_m)):
        _open(e, gate, widest_m)
    if not goes_on:
        _require_fresh(e)


def _open(e: Equipment, gate: Gate, width_m: float) -> HandState:
    """Open the hand. Raises: HandFault when it is not open then."""
    state = _move(gate, lambda: e.hand.move(width_m, e.station.hand.max_speed_m_s))
    require_at(state, width_m)
    return state


def _require_fresh(e: Equipment) -> None:
    """Refuse a frame older than ``camera.max_age_s``. Raises: CycleFailure."""
    clock = clock_of(e.station)
    asked_ns, asked_s = time.time_ns(), clock.now_s()
    stamp_ns = e.camera.capture().stamp_ns
    age_s = (asked_ns - stamp_ns) / 1e9 + clock.now_s() - asked_s
    if age_s > e.station.camera.max_age_s:
        raise CycleFailure(Code.STALE_FRAME, f"The camera's newest frame is {age_s:.1f} s old.{clock.busy_note()}")


def _to_capture_pose(e: Equipment, gate: Gate, q_rad: Joints) -> None:
    home_q_rad = np.asarray(e.station.arm.capture_q_rad)
    if float(np.abs(q_rad - home_q_rad).max()) < _AT_CAPTURE_RAD:
        return
    way = move(Scene.of(e.robot, e.station, cancel=gate.cancel), q_rad, home_q_rad)
    motion = _move(gate, lambda: e.arm.execute(way))
    if not motion.finished:
        raise CycleFailure(Code.STOPPED, "Stopped on the way to the capture pose.")


def _move(gate: Gate, motion: Callable[[], DoneT]) -> DoneT:
    with gate.motion() as may_begin:
        if may_begin:
            return motion()
    raise CycleFailure(Code.STOPPED, "Stopped while resetting.")
