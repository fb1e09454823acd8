"""The Franka Research 3 as an `Arm`: runs its control process and sends it requests. Signs: docs/frames.md."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from bus.errors import MotionRefused, NotConnected
from bus.messages import ArmMode, ArmState, Motion
from bus.trajectory import Trajectory
from config.hardware import Fr3Settings
from config.schema import Station
from drivers.fr3.errors import advice_of_mode, arm_mode
from drivers.fr3.loop import Request
from drivers.fr3.player import Played
from drivers.fr3.process import ControlProcess
from drivers.fr3.shared_state import MotionRequest, RobotSnapshot
from drivers.interface import Devices
from drivers.motion.unmoved import unmoved

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Asked:
    """One `execute` that has not returned, and the state wanted for its motion since."""

    want: MotionRequest
    plays: ControlProcess | None = None


class Fr3Arm:
    """Plays trajectories on an FR3, sample by sample at 1 kHz, in a separate process.

    Args:
        station: ``fr3`` and ``arm.start_tolerance_rad`` are used.
        start: starts that process. Raises: DriverUnavailable.
    """

    def __init__(self, station: Station, start: Callable[[Fr3Settings], ControlProcess] = ControlProcess) -> None:
        self._settings, self._start = station.fr3, start
        self._tolerance_rad = station.arm.start_tolerance_rad
        self._process: ControlProcess | None = None
        self._one = threading.Lock()  # one request at a time
        self._turn = threading.Lock()  # guards `_asked`, and the shared state's `want`
        self._asked: list[_Asked] = []

    # --- life ---------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Start the control process and wait for the robot's first state.

        Raises:
            DriverUnavailable: no package, no real-time kernel, no robot, or it refuses the connection; with what to do.
        """
        if self._process is None:
            self._process = self._start(self._settings)

    def close(self) -> None:
        """Stop the arm and end the control process; idempotent."""
        self.stop()
        with self._one:
            process, self._process = self._process, None
        if process is not None:
            process.end()

    def _require(self) -> ControlProcess:
        process = self._process
        if process is None:
            raise NotConnected("The FR3 is not connected.", "Call connect() first.")
        return process

    # --- state --------------------------------------------------------------------------------------------------------

    def state(self) -> ArmState:
        """Return the measured state.

        Raises:
            NotConnected: before `connect` and after `close`.
            DeviceLost: the robot has been silent for half a second.
        """
        now = self._require().snapshot()
        with self._turn:
            is_moving = any(asked.plays is not None for asked in self._asked)
        return _state(now, ArmMode.MOVE if is_moving else arm_mode(now.mode))

    def readings(self) -> dict[str, float]:
        """Return ``success_rate`` of the commands and ``lost_cycles``; empty while there is no connection."""
        process = self._process
        now = process.newest() if process is not None else None
        return {} if now is None else {"success_rate": now.success_rate, "lost_cycles": float(now.lost_cycles)}

    # --- motion -------------------------------------------------------------------------------------------------------

    def execute(self, trajectory: Trajectory) -> Motion:
        """Play ``trajectory``, joined to the robot's commanded position (see `drivers.fr3.player`).

        Raises:
            NotConnected: before `connect` and after `close`.
            MotionRefused: nothing moved: the arm's mode forbids motion, or its commanded position is elsewhere.
            ArmReflex: the arm stopped itself; the text has the robot's own error names.
            DeviceLost: the robot or its control process fell silent.
        """
        self._require()
        asked = _Asked(MotionRequest.PLAY if trajectory.waits_at is None else MotionRequest.WAIT)
        with self._turn:
            self._asked.append(asked)
        try:
            with self._one:
                return self._execute(trajectory, asked)
        finally:
            with self._turn:
                self._asked.remove(asked)

    def _execute(self, trajectory: Trajectory, asked: _Asked) -> Motion:
        process = self._require()
        now = process.snapshot()
        mode = arm_mode(now.mode)
        if mode is not ArmMode.IDLE:
            raise MotionRefused(f"The arm may not move: it is in mode {mode.value!r}.", advice_of_mode(now.mode))
        with self._under_way(process, asked) as may_begin:
            played = process.answer(Request(trajectory, self._tolerance_rad)) if may_begin else None
        if not may_begin:
            return unmoved(_state(now, mode), trajectory)
        assert isinstance(played, Played), "an execute is answered with what was played"
        if not played.finished and played.contact_n is None and asked.want is not MotionRequest.STOP:
            _log.warning("the motion was braked: this process stood still for too long")
        return Motion(
            finished=played.finished,
            commanded_q_rad=played.commanded_q_rad,
            t_s=played.t_s,
            q_rad=played.q_rad,
            dq_rad_s=played.dq_rad_s,
            tau_ext_nm=played.tau_ext_nm,
            contact_n=played.contact_n,
        )

    @contextmanager
    def _under_way(self, process: ControlProcess, asked: _Asked) -> Iterator[bool]:
        """Yield whether the motion may begin, that is, was not stopped before. After the block no motion is wanted."""
        with self._turn:
            may_begin = asked.want is not MotionRequest.STOP
            if may_begin:
                process.shared.ask(asked.want)
                asked.plays = process
        try:
            yield may_begin
        finally:
            with self._turn:
                asked.plays = None
                process.shared.ask(MotionRequest.STOP)

    def stop(self) -> None:
        """Brake every running and waiting motion on its path, for good."""
        with self._turn:
            for asked in self._asked:
                _want(asked, MotionRequest.STOP)

    def hold(self) -> None:
        """Brake every running and waiting motion on its path and wait there; without effect on a stopped one."""
        with self._turn:
            for asked in self._asked:
                if asked.want is not MotionRequest.STOP:
                    _want(asked, MotionRequest.HOLD)

    def resume(self) -> None:
        """Continue every held motion. Raises: MotionRefused when none is held; NotConnected."""
        self._require()
        with self._turn:
            held = [asked for asked in self._asked if asked.want in (MotionRequest.HOLD, MotionRequest.WAIT)]
            if not held:
                raise MotionRefused("No motion of the arm is held.", "Only a held motion goes on; plan a new one.")
            for asked in held:
                _want(asked, MotionRequest.PLAY)

    def recover(self) -> None:
        """Clear a reflex; when the robot was lost, reconnect first. Nothing moves.

        Raises:
            NotConnected: before `connect` and after `close`.
            DriverUnavailable: the robot is not back.
            MotionRefused: Desk has to be used first.
        """
        self._require()
        with self._one:
            process = self._require()
            if process.is_lost:
                process.end()
                self._process = process = self._start(self._settings)
            mode = arm_mode(process.snapshot().mode)
            if mode is ArmMode.REFLEX:
                process.answer(Request())
            elif mode not in (ArmMode.IDLE, ArmMode.MOVE):
                number = process.snapshot().mode
                raise MotionRefused(f"The arm cannot recover by itself: it is in mode {mode.value!r}.",
                                    advice_of_mode(number))  # fmt: skip


def _want(asked: _Asked, want: MotionRequest) -> None:
    asked.want = want
    if asked.plays is not None:
        asked.plays.shared.ask(want)


def _state(now: RobotSnapshot, mode: ArmMode) -> ArmState:
    return ArmState(
        stamp_ns=now.stamp_ns,
        mode=mode if not now.busy else ArmMode.OTHER,
        q_rad=now.q_rad,
        dq_rad_s=now.dq_rad_s,
        tau_ext_nm=now.tau_ext_nm,
    )


def open_devices(station: Station) -> Devices:
    """Make the devices of driver ``fr3``; entry point of the driver registry."""
    return Devices(arm=Fr3Arm(station))
