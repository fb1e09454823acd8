"""The driver's side of the arm's control process: starts it, sends requests, reads its state, ends it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection

from bus.commands import ErrorReply
from bus.errors import DeviceAbsent, DeviceLost, DriverError, DriverUnavailable
from bus.remote_errors import error_from_reply
from bus.threads import OwnedThread, Role
from config.hardware import Fr3Settings
from drivers.fr3.loop import Request
from drivers.fr3.player import Played
from drivers.fr3.shared_state import RobotSnapshot, SharedState

_CONNECT_S = 20.0
_STALE_S = 0.5
"""An older state means that the robot or the control process is gone: both renew it every millisecond."""
_END_S = 3.0
_LOOK_S = 0.05
_BEAT_S = 0.05
"""Period of the heartbeat: a tenth of the silence after which the control process takes the driver for frozen."""
LOST_ADVICE = "Check the arm's power and network; when it is back, `cell clear` and `cell reset`."


class ControlProcess:
    """One control process, connected to the robot.

    Attributes:
        shared: memory shared with the process.

    Raises:
        DriverUnavailable: with what to do.
    """

    def __init__(self, settings: Fr3Settings) -> None:
        self.shared = SharedState.create()
        self._address = settings.address
        ours, theirs = socket.socketpair()
        with theirs:
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-m", "drivers.fr3", str(theirs.fileno()), str(self.shared.descriptor)],
                pass_fds=(theirs.fileno(), self.shared.descriptor),
                stdin=subprocess.DEVNULL,
            )
        self._requests = Connection(os.dup(ours.fileno()))
        ours.close()
        self._lost = False
        self._ending = threading.Event()
        OwnedThread(Role.LOOP, self._beat, of="fr3-heartbeat").start()
        try:
            self._requests.send(settings.model_dump_json())
            self._answer_within(_CONNECT_S)
        except DriverError:
            self.end()
            raise

    @property
    def is_lost(self) -> bool:
        """Whether the process ended, or the robot fell silent."""
        if self._lost or self._child.poll() is not None:
            return True
        now = self.shared.read()
        return now is None or (not now.busy and _age_s(now) > _STALE_S)

    def newest(self) -> RobotSnapshot | None:
        """Return the newest state, or None when the robot or the process is lost."""
        return None if self.is_lost else self.shared.read()

    def snapshot(self) -> RobotSnapshot:
        """Return the newest state. Raises: DeviceLost."""
        now = self.newest()
        if now is None:
            raise DeviceLost(f"The FR3 at {self._address} does not answer any more.", LOST_ADVICE)
        return now

    def answer(self, request: Request) -> Played | None:
        """Send a request and wait for the answer while the robot is alive. Raises: DeviceLost; the answer's error."""
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
            raise DeviceLost("The arm's control process ended.", LOST_ADVICE) from error

    def _answer_within(self, patience_s: float) -> None:
        if not self._requests.poll(patience_s):
            raise DeviceAbsent(
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

    def _beat(self) -> None:
        """Publish the heartbeat every 50 ms, until the end."""
        while not self._ending.wait(_BEAT_S):
            self.shared.beat(time.monotonic_ns())

    def end(self) -> None:
        """Close the requests, upon which the process brakes any motion and ends; after 3 s it is killed. Idempotent."""
        self._lost = True
        self._ending.set()
        if self._requests.closed:
            return
        self._requests.close()
        try:
            self._child.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self.shared.close()


def _age_s(now: RobotSnapshot) -> float:
    return (time.monotonic_ns() - now.heard_ns) / 1e9
