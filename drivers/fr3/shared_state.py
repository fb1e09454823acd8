"""Memory shared by the arm's driver and its control process: the newest state one way, the wanted motion the other."""

from __future__ import annotations

import mmap
import os
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from bus.arrays import Joints
from bus.errors import DriverError

_JOINTS = ("q_rad", "dq_rad_s", "tau_ext_nm", "q_d_rad")
_LAYOUT = np.dtype(
    [
        ("sequence", "u8"),  # odd while a state is being written
        ("stamp_ns", "i8"),
        ("heard_ns", "i8"),
        ("mode", "u8"),
        ("success_rate", "f8"),
        ("lost_cycles", "u8"),
        ("busy", "u1"),
        ("want", "u1"),
        ("beat_ns", "i8"),
        *((name, "f8", 7) for name in _JOINTS),
    ]
)
_TRIES = 10_000
MOVE = 2
"""libfranka's RobotMode while the robot is controlled."""


class MotionRequest(IntEnum):
    """The state wanted for the running motion."""

    PLAY = 0
    HOLD = 1
    STOP = 2
    WAIT = 3
    """Play until where the trajectory waits by itself."""


@dataclass(frozen=True)
class RobotSnapshot:
    """One state of the robot, consistent in itself.

    Attributes:
        stamp_ns, heard_ns: time of arrival, in UTC and by the monotonic clock, which all processes share.
        mode: libfranka's RobotMode.
        q_rad, dq_rad_s: (7,) measured. ``q_d_rad``: (7,) commanded position.
        tau_ext_nm: (7,) external torque on each joint.
        success_rate: share of the last 100 commands of the newest motion that came in time.
        lost_cycles: since the connection was made.
        busy: the control process performs a call longer than a cycle; the state may be old.
    """

    stamp_ns: int
    heard_ns: int
    mode: int
    success_rate: float
    lost_cycles: int
    busy: bool
    q_rad: Joints
    dq_rad_s: Joints
    tau_ext_nm: Joints
    q_d_rad: Joints


class SharedState:
    """One record of shared memory, behind a file descriptor that a child process inherits; one writer per field."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._map = mmap.mmap(descriptor, _LAYOUT.itemsize)
        self._record: Any = np.frombuffer(self._map, _LAYOUT)

    @classmethod
    def create(cls) -> SharedState:
        """Make the memory, and the descriptor for a child process."""
        descriptor = os.memfd_create("fr3-state", 0)
        os.truncate(descriptor, _LAYOUT.itemsize)
        return cls(descriptor)

    def close(self) -> None:
        """Close the descriptor; the record can still be read."""
        os.close(self.descriptor)

    # --- the driver's side --------------------------------------------------------------------------------------------

    def read(self) -> RobotSnapshot | None:
        """Return the newest state; None before the first. Raises: DriverError when it stays half-written."""
        for _ in range(_TRIES):
            before = int(self._record["sequence"][0])
            copy = self._record[0].copy()
            if before % 2 == 0 and int(self._record["sequence"][0]) == before:
                return _snapshot(copy) if before else None
        raise DriverError("The control process died while it wrote the arm's state.", "Recover the arm.")

    def ask(self, want: MotionRequest) -> None:
        """Set the state wanted for the running motion."""
        self._record["want"][0] = want

    def beat(self, now_ns: int) -> None:
        """Set the driver's heartbeat to ``now_ns`` of the monotonic clock."""
        self._record["beat_ns"][0] = now_ns

    # --- the control process's side -----------------------------------------------------------------------------------

    @property
    def want(self) -> int:
        """The state wanted for the running motion, a `MotionRequest`."""
        return int(self._record["want"][0])

    @property
    def beat_ns(self) -> int:
        """The driver's newest heartbeat by the monotonic clock; 0 = none yet."""
        return int(self._record["beat_ns"][0])

    def say_busy(self, busy: bool) -> None:
        """Mark whether a call longer than a cycle is running."""
        self._record["busy"][0] = busy

    def write(self, stamp_ns: int, heard_ns: int, state: Any, lost_cycles: int) -> None:
        """Publish one libfranka RobotState.

        Its ``tau_ext_hat_filtered`` is the robot's counter torque (a gripper pulled down reads as an upward force:
        libfranka issue 26); ours is the external torque on the joints (docs/frames.md), so the sign changes.

        Args:
            stamp_ns, heard_ns: time of arrival, in UTC and by the monotonic clock.
        """
        record = self._record
        record["sequence"][0] += 1
        record["stamp_ns"][0], record["heard_ns"][0] = stamp_ns, heard_ns
        record["mode"][0] = int(state.robot_mode)
        if record["mode"][0] == MOVE:  # at rest the robot says 0
            record["success_rate"][0] = state.control_command_success_rate
        record["lost_cycles"][0] = lost_cycles
        record["q_rad"][0], record["dq_rad_s"][0], record["q_d_rad"][0] = state.q, state.dq, state.q_d
        np.negative(state.tau_ext_hat_filtered, out=record["tau_ext_nm"][0])
        record["sequence"][0] += 1


def _snapshot(record: Any) -> RobotSnapshot:
    joints = {name: np.array(record[name]) for name in _JOINTS}
    return RobotSnapshot(
        stamp_ns=int(record["stamp_ns"]),
        heard_ns=int(record["heard_ns"]),
        mode=int(record["mode"]),
        success_rate=float(record["success_rate"]),
        lost_cycles=int(record["lost_cycles"]),
        busy=bool(record["busy"]),
        **joints,
    )
