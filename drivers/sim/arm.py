"""The simulated FR3: position servos that follow 1 kHz commands, and feel what they touch."""

from __future__ import annotations

import threading

import numpy as np

from bus.errors import NotConnected
from bus.messages import ArmMode, ArmState, Motion
from bus.trajectory import Trajectory
from drivers.sim.world import World
from drivers.stream import Stream

_MEASURE_TICKS = 10
_TORQUE_NOISE_NM = 0.02
_REST_RAD_S = 0.005
_SETTLE_TICKS = 300


class SimArm:
    """Plays trajectories on the world's arm, one tick a millisecond of robot time."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._connected = False
        self._stream: Stream | None = None
        self._motion_lock = threading.Lock()
        self._motions = 0

    def connect(self) -> None:
        self._connected = True

    def close(self) -> None:
        self.stop()
        self._connected = False

    def state(self) -> ArmState:
        self._require()
        q_rad, dq_rad_s, tau_ext_nm = self._world.arm()
        return ArmState(
            stamp_ns=self._world.clock_ns(),
            mode=ArmMode.IDLE if self._stream is None else ArmMode.MOVE,
            q_rad=q_rad,
            dq_rad_s=dq_rad_s,
            tau_ext_nm=tau_ext_nm,
        )

    def execute(self, trajectory: Trajectory) -> Motion:
        self._require()
        with self._motion_lock:
            stream = self._stream = Stream(trajectory)
            try:
                return self._play(stream)
            finally:
                self._stream = None

    def _play(self, stream: Stream) -> Motion:
        commanded: list[np.ndarray] = []
        measured: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        while (command := stream.next()) is not None:
            if len(commanded) % _MEASURE_TICKS == 0:
                measured.append(self._world.arm())
            self._world.command_arm(command)
            self._world.tick()
            commanded.append(command)
            self._world.pace(len(commanded))
        self._settle()
        measured.append(self._world.arm())
        self._motions += 1
        rng = np.random.default_rng([self._world.station.sim.seed, self._motions])
        q_rad, dq_rad_s, tau_ext_nm = (np.array(column) for column in zip(*measured, strict=True))
        ticks = np.append(np.arange(len(measured) - 1) * _MEASURE_TICKS, len(commanded))
        return Motion(
            finished=stream.finished,
            commanded_q_rad=np.array(commanded).reshape(-1, 7),
            t_s=ticks * 0.001,
            q_rad=q_rad,
            dq_rad_s=dq_rad_s,
            tau_ext_nm=tau_ext_nm + rng.normal(0.0, _TORQUE_NOISE_NM, tau_ext_nm.shape),
        )

    def _settle(self) -> None:
        """Let the servos come to rest: in lockstep no time passes between two motions."""
        for _ in range(_SETTLE_TICKS):
            if np.abs(self._world.arm()[1]).max() < _REST_RAD_S:
                return
            self._world.tick()

    def stop(self) -> None:
        stream = self._stream
        if stream is not None:
            stream.brake()

    def recover(self) -> None:
        """The simulated arm has no reflex to clear."""
        self._require()

    def _require(self) -> None:
        if not self._connected:
            raise NotConnected("The simulated arm is not connected.", "Call connect() first.")
