"""The Franka Research 3 as an `Arm`: its control process, and what is asked of it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection

from bus.commands import ErrorReply
from bus.errors import DeviceLost, DriverError, DriverUnavailable, MotionRefused, NotConnected
from bus.messages import ArmMode, ArmState, Motion
from bus.remote_errors import error_from_reply
from bus.trajectory import Trajectory
from config.schema import Station
from drivers.fr3.block import Block, Snapshot, Want
from drivers.fr3.faults import advice_of_mode, arm_mode
from drivers.fr3.loop import Request
from drivers.fr3.player import Played
from drivers.interface import Devices

_CONNECT_S = 20.0
_STALE_S = 0.5
"""A state so old means that the robot or the control process is gone: both renew it every millisecond."""
_RECOVERY_S = 20.0
_END_S = 3.0
_LOOK_S = 0.05
_LOST_ADVICE = "Check the arm's power and network; when it is back, `cell clear` and `cell reset`."


class Fr3Arm:
    """Plays trajectories on an FR3, sample by sample at 1 kHz, from a process of its own."""

    def __init__(self, station: Station) -> None:
        self._settings = station.fr3
        self._tolerance_rad = station.arm.start_tolerance_rad
        self._process: _Process | None = None
        self._asking = threading.Lock()  # one request at a time
        self._turn = threading.Lock()  # guards these two, and the block's `want`
        self._moving = False
        self._want = Want.PLAY

    # --- life ---------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Start the control process and wait for the robot's first state.

        Raises: DriverUnavailable: no package, no real-time kernel, no robot, or it does not accept us; with what to do.
        """
        if self._process is None:
            self._process = _Process(self._settings.model_dump_json(), self._settings.address)

    def close(self) -> None:
        self.stop()
        with self._asking:
            process, self._process = self._process, None
        if process is not None:
            process.end()

    def _require(self) -> _Process:
        process = self._process
        if process is None:
            raise NotConnected("The FR3 is not connected.", "Call connect() first.")
        return process

    # --- state --------------------------------------------------------------------------------------------------------

    def state(self) -> ArmState:
        """Raises: DeviceLost when the robot has been silent for half a second."""
        now = self._require().snapshot()
        mode = ArmMode.MOVE if self._moving else arm_mode(now.mode)
        return ArmState(
            stamp_ns=now.stamp_ns,
            mode=mode if not now.busy else ArmMode.OTHER,
            q_rad=now.q_rad,
            dq_rad_s=now.dq_rad_s,
            tau_ext_nm=now.tau_ext_nm,
        )

    def readings(self) -> dict[str, float]:
        """``success_rate`` of the commands and ``lost_cycles``; empty while there is no connection."""
        process = self._process
        now = process.newest() if process is not None else None
        return {} if now is None else {"success_rate": now.success_rate, "lost_cycles": float(now.lost_cycles)}

    # --- motion -------------------------------------------------------------------------------------------------------

    def execute(self, trajectory: Trajectory) -> Motion:
        """Play ``trajectory``, joined to where the robot is commanded to be (see `drivers.fr3.player`).

        Raises:
            MotionRefused: nothing moved: the arm is in a mode in which it must not, or is commanded to be elsewhere.
            ArmReflex: it stopped itself; the text has the robot's own names.
            DeviceLost: the robot or its control process fell silent.
        """
        process = self._require()
        with self._asking:
            now = process.snapshot()
            if arm_mode(now.mode) is not ArmMode.IDLE:
                raise MotionRefused(
                    f"The arm may not move: it is in mode {arm_mode(now.mode).value!r}.", advice_of_mode(now.mode)
                )
            request = Request(trajectory, self._tolerance_rad)
            with self._turn:
                self._moving = True
                self._ask(process, Want.PLAY)
            try:
                played = process.answer(request)
            finally:
                with self._turn:
                    self._moving = False
        assert isinstance(played, Played), "an execute is answered with what was played"
        return Motion(
            finished=played.finished,
            commanded_q_rad=played.commanded_q_rad,
            t_s=played.t_s,
            q_rad=played.q_rad,
            dq_rad_s=played.dq_rad_s,
            tau_ext_nm=played.tau_ext_nm,
        )

    def stop(self) -> None:
        with self._turn:
            if self._moving and self._process is not None:
                self._ask(self._process, Want.STOP)

    def hold(self) -> None:
        with self._turn:
            if self._moving and self._process is not None and self._want is not Want.STOP:
                self._ask(self._process, Want.HOLD)

    def resume(self) -> None:
        process = self._require()
        with self._turn:
            if not self._moving or self._want is not Want.HOLD:
                raise MotionRefused("No motion of the arm is held.", "Only a held motion goes on; plan a new one.")
            self._ask(process, Want.PLAY)

    def _ask(self, process: _Process, want: Want) -> None:
        self._want = want
        process.block.ask(want)

    def recover(self) -> None:
        """Clear a reflex; when the robot was lost, connect to it anew first. Nothing moves.

        Raises: DriverUnavailable when it is not back; MotionRefused when Desk has to be used first.
        """
        process = self._require()
        with self._asking:
            if process.is_lost:
                process.end()
                self._process = process = _Process(self._settings.model_dump_json(), self._settings.address)
            mode = arm_mode(process.snapshot().mode)
            if mode is ArmMode.REFLEX:
                process.answer(Request())
            elif mode not in (ArmMode.IDLE, ArmMode.MOVE):
                number = process.snapshot().mode
                raise MotionRefused(f"The arm cannot recover by itself: it is in mode {mode.value!r}.",
                                    advice_of_mode(number))  # fmt: skip


class _Process:
    """One control process, connected to the robot. Raises: as `Fr3Arm.connect`."""

    def __init__(self, settings_json: str, address: str) -> None:
        self.block = Block.create()
        self._address = address
        ours, theirs = socket.socketpair()
        with theirs:
            self._child = subprocess.Popen(
                [sys.executable, "-m", "drivers.fr3", str(theirs.fileno()), str(self.block.descriptor)],
                pass_fds=(theirs.fileno(), self.block.descriptor),
                stdin=subprocess.DEVNULL,
            )
        self._requests = Connection(os.dup(ours.fileno()))
        ours.close()
        self._lost = False
        try:
            self._requests.send(settings_json)
            self._answer_within(_CONNECT_S)
        except DriverError:
            self.end()
            raise

    @property
    def is_lost(self) -> bool:
        """Whether it ended, or the robot fell silent."""
        if self._lost or self._child.poll() is not None:
            return True
        now = self.block.read()
        return now is None or (not now.busy and _age_s(now) > _STALE_S)

    def newest(self) -> Snapshot | None:
        """The newest state, or None when it is lost."""
        return None if self.is_lost else self.block.read()

    def snapshot(self) -> Snapshot:
        now = self.newest()
        if now is None:
            raise DeviceLost(f"The FR3 at {self._address} does not answer any more.", _LOST_ADVICE)
        return now

    def answer(self, request: Request) -> Played | None:
        """Ask, and wait for the answer as long as the robot is alive. Raises: what the answer says; DeviceLost."""
        try:
            self._requests.send(request)
            while not self._requests.poll(_LOOK_S):
                self.snapshot()
            return self._received()
        except DeviceLost:
            self._lost = True
            raise
        except OSError as error:
            self._lost = True
            raise DeviceLost("The arm's control process ended.", _LOST_ADVICE) from error

    def _answer_within(self, patience_s: float) -> None:
        if not self._requests.poll(patience_s):
            raise DriverUnavailable(
                f"The FR3 at {self._address} did not answer within {patience_s:.0f} s.", "Is it still starting?"
            )
        try:
            self._received()
        except OSError as error:
            raise DriverUnavailable(
                f"The arm's control process ended at once (exit code {self._child.wait()}).",
                "Its message stands above.",
            ) from error

    def _received(self) -> Played | None:
        try:
            received: Played | ErrorReply | None = self._requests.recv()
        except EOFError as error:
            raise ConnectionResetError from error
        if isinstance(received, ErrorReply):
            raise error_from_reply(received)
        return received

    def end(self) -> None:
        """It brakes what moves and ends when nobody listens any more; insist if it does not. Idempotent."""
        self._lost = True
        if self._requests.closed:
            return
        self._requests.close()
        try:
            self._child.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self.block.close()


def _age_s(now: Snapshot) -> float:
    return (time.time_ns() - now.stamp_ns) / 1e9


def open_devices(station: Station) -> Devices:
    """What the driver registry loads under the name ``fr3``."""
    return Devices(arm=Fr3Arm(station))
