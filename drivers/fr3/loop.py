"""The arm's control process: answers the robot every millisecond, and does nothing else.

`drivers.fr3.arm` starts it with two inherited file descriptors: the memory of `SharedState` and a socket for requests.
libfranka holds Python's lock in every call, so this cannot be a thread of the driver.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import itertools
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from bus.commands import ErrorReply
from bus.errors import CellError, DriverUnavailable, MotionRefused
from bus.remote_errors import error_reply
from bus.trajectory import TICK_S, Trajectory
from config.hardware import Fr3Settings
from drivers.fr3.errors import connect_error, motion_error, raised_by
from drivers.fr3.player import Played, Player
from drivers.fr3.shared_state import SharedState

_LOOK_TICKS = 50
"""Period of the check during a motion that the driver is still there."""
SILENT_NS = 500_000_000
"""A driver silent for so long is frozen, and the arm could not be stopped through it: then the motion brakes. A busy
machine delays it by less, and at 3 rad/s the arm is at rest within a second and 2 rad."""
_PRIORITY = 80
_NICE = -10
_MCL_CURRENT_AND_FUTURE = 3


@dataclass(frozen=True)
class Request:
    """A request of the driver: play a trajectory, or, without one, recover.

    The answer is a `Played`, an `ErrorReply`, or None.

    Attributes:
        tolerance_rad: largest accepted distance between the trajectory's start and the commanded position.
    """

    trajectory: Trajectory | None = None
    tolerance_rad: float = 0.0


class ControlLoop:
    """One connection to one robot.

    Args:
        franka: the module ``pylibfranka``. ``gone``: whether the driver has closed its socket.
        clock_ns: the monotonic clock of the driver's heartbeat.
    """

    def __init__(
        self,
        franka: Any,
        settings: Fr3Settings,
        shared: SharedState,
        gone: Callable[[], bool],
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._franka, self._shared, self._gone, self._clock_ns = franka, shared, gone, clock_ns
        enforce = settings.realtime == "enforce"
        realtime = franka.RealtimeConfig.kEnforce if enforce else franka.RealtimeConfig.kIgnore
        self._robot = franka.Robot(settings.address, realtime)
        _configure(self._robot, settings)
        self._lost_cycles = 0
        self.idle()

    def idle(self) -> None:
        """Run one cycle without a motion, to keep the state fresh."""
        self._publish(self._robot.read_once())

    def recover(self) -> None:
        """Clear a reflex; takes 50 ms to some seconds. Nothing moves."""
        self._shared.say_busy(True)
        try:
            self._robot.automatic_error_recovery()
        finally:
            self.idle()
            self._shared.say_busy(False)

    def play(self, trajectory: Trajectory, tolerance_rad: float) -> Played:
        """Stream ``trajectory`` and return when the arm rests.

        Args:
            tolerance_rad: largest accepted distance between the trajectory's start and the commanded position.

        Raises:
            MotionRefused: the start is farther away; nothing moved.
            Exception: one of `raised_by`, from libfranka.
        """
        player = Player(trajectory, self._shared)
        control = self._robot.start_joint_position_control(self._franka.ControllerMode.JointImpedance)
        state, _ = control.readOnce()
        try:
            command = player.begin(state, tolerance_rad)
        except MotionRefused:
            self._finish(control, np.array(state.q_d))
            raise
        for cycle in itertools.count(1):
            control.writeOnce(self._positions(command))
            state, period = control.readOnce()
            self._publish(state)
            ticks = max(1, round(period.to_sec() / TICK_S))  # robot time, which counts lost cycles too
            self._lost_cycles += ticks - 1
            following = player.advance(ticks, state)
            if following is None:
                break
            command = following
            if self._is_silent() or (cycle % _LOOK_TICKS == 0 and self._gone()):
                player.brake()
        self._finish(control, command)
        self.idle()
        return player.played(self._robot.read_once())

    def _is_silent(self) -> bool:
        """Whether the driver process is frozen: it exists, but the arm cannot be stopped through it."""
        return self._clock_ns() - self._shared.beat_ns > SILENT_NS

    def _finish(self, control: Any, command: Any) -> None:
        last = self._positions(command)
        last.motion_finished = True
        control.writeOnce(last)

    def _positions(self, command: Any) -> Any:
        return self._franka.JointPositions(command.tolist())

    def _publish(self, state: Any) -> None:
        self._shared.write(time.time_ns(), self._clock_ns(), state, self._lost_cycles)


def _configure(robot: Any, settings: Fr3Settings) -> None:
    torque_nm, wrench = list(settings.collision_torque_nm), list(settings.collision_wrench)
    robot.set_collision_behavior(torque_nm, torque_nm, wrench, wrench)
    robot.set_joint_impedance(list(settings.joint_stiffness_nm_rad))
    load = settings.load
    robot.set_load(load.mass_kg, list(load.flange_from_center_m), np.diag(load.inertia_kg_m2).ravel().tolist())


def _be_punctual() -> None:
    """Set real-time priority and lock the memory. Raises: DriverUnavailable where that is not allowed."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except PermissionError as error:
        raise DriverUnavailable(
            "The arm's control process may not run at real-time priority.",
            "Add `@realtime - rtprio 99` and `@realtime - memlock unlimited` to /etc/security/limits.conf, join that"
            " group and log in again (`cell doctor`).",
        ) from error
    if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
        raise DriverUnavailable(
            f"Memory cannot be locked: {os.strerror(ctypes.get_errno())}.", "Raise memlock in limits.conf, as above."
        )


def open_loop(settings: Fr3Settings, shared: SharedState, gone: Callable[[], bool]) -> ControlLoop:
    """Connect to the robot and configure it. Raises: DriverUnavailable, with what to do."""
    try:
        franka = importlib.import_module("pylibfranka")
    except ImportError as error:
        raise DriverUnavailable(
            f"pylibfranka cannot be imported: {error}.",
            "uv pip install 'vlad-cell[fr3]'; it has wheels for Python 3.11 and 3.12.",
        ) from error
    if settings.realtime == "enforce":
        _be_punctual()
    else:
        with suppress(PermissionError):  # without real-time priority at least a higher one
            os.nice(_NICE)
    try:
        return ControlLoop(franka, settings, shared, gone)
    except raised_by(franka) as error:
        raise connect_error(error, settings.address) from error


def serve(requests: Connection, shared: SharedState) -> int:
    """Answer requests until the driver or the robot is gone. Returns the exit code."""
    settings = Fr3Settings.model_validate_json(requests.recv())

    try:
        loop = open_loop(settings, shared, gone=requests.poll)  # no request comes during a motion, only the end
    except CellError as error:
        requests.send(error_reply(error))
        return error.exit_code
    requests.send(None)
    gc.freeze()
    gc.disable()
    return _serve(loop, requests)


def _serve(loop: ControlLoop, requests: Connection) -> int:
    lost = raised_by(importlib.import_module("pylibfranka"))
    while True:
        try:
            if requests.poll():
                requests.send(_answer(loop, requests.recv()))
                gc.collect()
            loop.idle()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return 0
        except lost as error:
            print(f"fr3: {motion_error(error)}", file=sys.stderr)  # noqa: T201
            return 1


def _answer(loop: ControlLoop, request: Request) -> Played | ErrorReply | None:
    faults = raised_by(importlib.import_module("pylibfranka"))
    try:
        if request.trajectory is not None:
            return loop.play(request.trajectory, request.tolerance_rad)
        loop.recover()
    except CellError as error:
        return error_reply(error)
    except faults as error:
        failure = error_reply(motion_error(error))
    else:
        return None
    loop.idle()  # publish the resulting mode before the driver gets the error
    return failure
