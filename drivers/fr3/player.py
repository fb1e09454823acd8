"""Computes the commands of one motion as the robot's time passes, and collects the measured states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bus.arrays import Joints, JointSamples, Samples
from bus.errors import MotionRefused
from bus.trajectory import TICK_S, Trajectory
from config.limits import FR3
from drivers.fr3.shared_state import MotionRequest, SharedState
from drivers.motion.stream import Stream

_MEASURE_TICKS = 10
_GENTLE_RAD_S2 = 0.05
"""Acceleration that fading out the first difference may add to the motion: half a percent of the limit."""


@dataclass(frozen=True)
class Played:
    """Outcome of one motion; the arm is at rest again.

    Attributes:
        finished: played to its end.
        commanded_q_rad: (n, 7), one row per tick (1 ms) of robot time.
        t_s, q_rad, dq_rad_s, tau_ext_nm: measured (m,) and (m, 7), every 10 ms.
        contact_n: the force at which the motion's guard braked it; None = it met nothing.
    """

    finished: bool
    commanded_q_rad: JointSamples
    t_s: Samples
    q_rad: JointSamples
    dq_rad_s: JointSamples
    tau_ext_nm: JointSamples
    contact_n: float | None = None


class Player:
    """Plays ``trajectory``, joined to the robot's commanded position, which its first command must equal exactly.

    Motions are planned from the measured position, some milliradians away. The difference fades out, so that the motion
    ends exactly where it was planned to, if need be a little later.

    Args:
        shared: gives the wanted state of the motion.

    Attributes:
        commanded: the commands (7,) so far [rad].
    """

    def __init__(self, trajectory: Trajectory, shared: SharedState) -> None:
        self._stream, self._shared = Stream(trajectory, FR3), shared
        self._planned_q_rad = trajectory.start_q_rad
        self._away_rad = np.zeros(7)
        self._tick = self._fade_ticks = 0
        self.commanded: list[Joints] = []
        self._measured: list[tuple[int, Any]] = []

    def begin(self, state: Any, tolerance_rad: float) -> Joints:
        """Return the first command (7,) [rad], from the robot's first state.

        Raises:
            MotionRefused: the trajectory starts more than ``tolerance_rad`` from the commanded position.
        """
        q_d_rad = np.array(state.q_d)
        self._stream.next()
        self._away_rad = q_d_rad - self._planned_q_rad
        joint = int(np.argmax(np.abs(self._away_rad)))
        largest_rad = abs(float(self._away_rad[joint]))
        if not largest_rad <= tolerance_rad:
            raise MotionRefused(
                f"The motion starts {largest_rad:.3f} rad from where joint {joint + 1} is commanded to be.",
                "Plan it from where the arm is.",
            )
        duration_s = np.sqrt(5.8 * largest_rad / _GENTLE_RAD_S2)  # 5.8: the quintic's greatest curvature
        self._fade_ticks = int(np.ceil(duration_s / TICK_S))
        self._measured.append((0, state))
        self.commanded.append(q_d_rad)
        return q_d_rad

    def advance(self, ticks: int, state: Any) -> Joints | None:
        """Return the command (7,) [rad] ``ticks`` (ms) later; None at the end. A motion held at rest keeps no ticks."""
        self._obey()
        if self._stream.is_felt:
            self._stream.feel(-np.array(state.tau_ext_hat_filtered))  # see SharedState.write
        command = None
        for _ in range(ticks):
            planned_q_rad = self._stream.next()
            if planned_q_rad is not None:
                self._planned_q_rad = planned_q_rad
            elif self._tick >= self._fade_ticks:
                break
            command = self._planned_q_rad + self._still_away_rad()
            if not (self._stream.held and np.array_equal(command, self.commanded[-1])):
                self._keep(command, state)
        return command

    def brake(self) -> None:
        """Come to rest on the path for good."""
        self._stream.brake()

    def played(self, at_rest: Any) -> Played:
        """Return the outcome; ``at_rest``: the robot's state after the motion."""
        measured = [*self._measured, (len(self.commanded), at_rest)]
        if len(measured) > 2 and measured[-1][0] - measured[-2][0] < _MEASURE_TICKS / 2:
            del measured[-2]  # the state at rest replaces a sample just before it
        states = [state for _, state in measured]
        return Played(
            finished=self._stream.finished,
            commanded_q_rad=np.array(self.commanded),
            t_s=np.array([tick for tick, _ in measured]) * TICK_S,
            q_rad=np.array([state.q for state in states]),
            dq_rad_s=np.array([state.dq for state in states]),
            tau_ext_nm=-np.array([state.tau_ext_hat_filtered for state in states]),  # see SharedState.write
            contact_n=self._stream.contact_n,
        )

    def _still_away_rad(self) -> Joints:
        """Return the rest of the first difference, one tick on: a quintic from 1 to 0."""
        self._tick += 1
        if self._tick >= self._fade_ticks:
            return np.zeros(7)
        share = self._tick / self._fade_ticks
        return self._away_rad * (1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2))

    def _keep(self, command: Joints, state: Any) -> None:
        self.commanded.append(command)
        if len(self.commanded) % _MEASURE_TICKS == 0:
            self._measured.append((len(self.commanded), state))

    def _obey(self) -> None:
        want = self._shared.want
        if want == MotionRequest.STOP:
            self._stream.brake()
        elif want == MotionRequest.HOLD:
            self._stream.hold()
        elif want == MotionRequest.PLAY:
            self._stream.resume()
