"""The simulated arm: position servos that follow 1 kHz commands, and measure contact torques. Signs: docs/frames.md."""

from __future__ import annotations

import threading

import numpy as np

from bus.arrays import Joints
from bus.errors import ArmReflex, MotionRefused, NotConnected
from bus.messages import ArmMode, ArmState, Motion
from bus.trajectory import TICK_S, Trajectory
from config.robot import limits_of
from drivers.motion.brake import brake_without_path
from drivers.motion.stream import Stream
from drivers.motion.unmoved import unmoved
from drivers.sim.world import World

_MEASURE_TICKS = 10
_TORQUE_NOISE_NM = 0.02
_TOUCH = 1
"""Parts the noise that a guard feels from that of the measurements, in their seeds."""
_STILL_RAD_S = 1e-3
_ARRIVED_RAD_S = 0.01
"""At the end of a motion the arm may still creep so fast towards its last command: the servo's lag fades in 0.1 s."""
_PATIENCE_TICKS = 300
_HELD_PATIENCE_TICKS = 1000
"""More than `_PATIENCE_TICKS`: a remaining speed would be reported until the end of the hold, as time stands still."""
_REFLEX_NM = 30.0
_REFLEX_SAMPLES = 3
"""The arm stops itself, as the FR3's collision behaviour does, when the external torque on any joint exceeds this in so
many consecutive samples: a push, not the knock of an object that slips from the fingers."""


class SimArm:
    """Plays trajectories on the world's arm, one tick per millisecond of robot time.

    While a motion is held at rest no time passes and nothing is computed: its `Motion` has no samples of the wait.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._connected = False
        self._asked: list[Stream] = []  # one per `execute` that has not returned; only the first may move
        self._turn = threading.Condition()  # guards `_asked`
        self._motions = 0
        self._reflex = False
        self._pushed_samples = 0

    def connect(self) -> None:
        """Mark as connected."""
        self._connected = True

    def close(self) -> None:
        """Stop and mark as not connected; idempotent."""
        self.stop()
        self._connected = False

    def state(self) -> ArmState:
        """Return the measured state. Raises: NotConnected."""
        self._require()
        q_rad, dq_rad_s, tau_ext_nm = self._world.arm()
        return ArmState(
            stamp_ns=self._world.clock_ns(),
            mode=self._mode(),
            q_rad=q_rad,
            dq_rad_s=dq_rad_s,
            tau_ext_nm=tau_ext_nm,
        )

    def _mode(self) -> ArmMode:
        if self._reflex:
            return ArmMode.REFLEX
        return ArmMode.MOVE if self._asked else ArmMode.IDLE

    def execute(self, trajectory: Trajectory) -> Motion:
        """Play ``trajectory`` and return when the arm rests, with measured samples every 10 ms.

        Raises:
            NotConnected: before `connect` and after `close`.
            ArmReflex: the external torque was too high and the arm stopped itself.
        """
        self._require()
        stream = Stream(trajectory, limits_of(self._world.station))
        with self._turn:
            self._asked.append(stream)
        try:
            with self._world.turns.taken():
                return unmoved(self.state(), trajectory) if stream.is_braked else self._play(stream)
        finally:
            with self._turn:
                self._asked.remove(stream)

    def _play(self, stream: Stream) -> Motion:
        commanded: list[np.ndarray] = []
        measured: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        try:
            self._follow(stream, commanded, measured)
        except Exception:
            self._brake_without_path(commanded)
            raise
        ticks = list(range(0, len(commanded), _MEASURE_TICKS))
        if len(commanded) - ticks[-1] < _MEASURE_TICKS / 2:  # the state at rest replaces a sample just before it
            measured.pop()
            ticks.pop()
        measured.append(self._world.arm())
        ticks.append(len(commanded))
        self._settle(commanded[-1], _PATIENCE_TICKS, _ARRIVED_RAD_S)
        self._motions += 1
        if self._reflex:
            raise ArmReflex("The arm touched something and stopped itself.", "Clear it, then recover.")
        rng = np.random.default_rng([self._world.station.sim.seed, self._motions])
        q_rad, dq_rad_s, tau_ext_nm = (np.array(column) for column in zip(*measured, strict=True))
        return Motion(
            finished=stream.finished,
            commanded_q_rad=np.array(commanded).reshape(len(commanded), -1),
            t_s=np.array(ticks) * TICK_S,
            q_rad=q_rad,
            dq_rad_s=dq_rad_s,
            tau_ext_nm=tau_ext_nm + rng.normal(0.0, _TORQUE_NOISE_NM, tau_ext_nm.shape),
            contact_n=stream.contact_n,
        )

    def _follow(
        self,
        stream: Stream,
        commanded: list[np.ndarray],
        measured: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    ) -> None:
        """Command every tick, and measure every tenth; append to the two lists."""
        noise = np.random.default_rng([self._world.station.sim.seed, self._motions, _TOUCH])
        while (command := stream.next()) is not None:
            if stream.held and commanded and np.array_equal(command, commanded[-1]):
                self._wait_held(stream, command)
                continue
            if len(commanded) % _MEASURE_TICKS == 0:
                measured.append(self._world.arm())
                self._feel(measured[-1][2])
            self._world.command_arm(command, commanded[-1] if commanded else command)
            self._world.tick()
            commanded.append(command)
            if stream.is_felt:
                stream.feel(self._world.arm()[2] + noise.normal(0.0, _TORQUE_NOISE_NM, len(command)))
            self._world.pace(len(commanded))

    def _brake_without_path(self, commanded: list[np.ndarray]) -> None:
        """After an error in the middle of a motion: brake the joints without a path, from their last three commands."""
        if len(commanded) < 3:
            return
        for command in brake_without_path(limits_of(self._world.station), np.array(commanded[-3:])):
            self._world.command_arm(command, commanded[-1])
            self._world.tick()
            commanded.append(command)
        self._settle(commanded[-1], _PATIENCE_TICKS)

    def _feel(self, tau_ext_nm: Joints) -> None:
        """Stop on the path when the external torque is too high."""
        self._pushed_samples = self._pushed_samples + 1 if np.abs(tau_ext_nm).max() > _REFLEX_NM else 0
        if self._pushed_samples >= _REFLEX_SAMPLES:
            self._reflex = True
            self.stop()

    def _settle(self, q_rad: Joints, patience_ticks: int, still_rad_s: float = _STILL_RAD_S) -> None:
        """Hold the last command until the arm rests."""
        self._world.command_arm(q_rad, q_rad)
        for tick in range(patience_ticks):
            if np.abs(self._world.arm_speed_rad_s()).max() < still_rad_s:
                return
            self._world.tick()
            self._world.pace(tick)

    def _wait_held(self, stream: Stream, q_rad: Joints) -> None:
        """Let the arm rest at the held command, then wait until `resume` or `stop`; the fingers move on."""
        self._settle(q_rad, _HELD_PATIENCE_TICKS)
        with self._world.turns.lent(), self._turn:
            self._turn.wait_for(lambda: not stream.is_held_or_about_to_be)

    def stop(self) -> None:
        """Brake every running and waiting motion on its path, for good."""
        with self._turn:
            for stream in self._asked:
                stream.brake()
            self._turn.notify_all()

    def hold(self) -> None:
        """Brake every running and waiting motion on its path and wait there."""
        with self._turn:
            for stream in self._asked:
                stream.hold()

    def resume(self) -> None:
        """Continue every held motion. Raises: MotionRefused when none is held or about to be; NotConnected."""
        self._require()
        with self._turn:
            if not any(stream.is_held_or_about_to_be for stream in self._asked):
                raise MotionRefused("No motion of the arm is held.", "Only a held motion goes on; plan a new one.")
            for stream in self._asked:
                stream.resume()
            self._turn.notify_all()

    def recover(self) -> None:
        """Clear a reflex. Raises: NotConnected."""
        self._require()
        self._reflex = False

    def _require(self) -> None:
        if not self._connected:
            raise NotConnected("The simulated arm is not connected.", "Call connect() first.")
