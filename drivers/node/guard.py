"""The last check before arm or hand move. It refuses and never repairs: an accepted motion is passed on unchanged."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from bus.errors import CellError, HandFault, MotionRefused
from bus.messages import ArmMode, ArmState, HandState, Motion
from bus.trajectory import Trajectory
from config.limits import JointLimits
from config.robot import limits_of
from config.schema import Station
from drivers.interface import Arm, Hand
from drivers.motion.stops import Stops
from drivers.motion.unmoved import unmoved


class Guard:
    """An `Arm` that refuses unsafe trajectories for the arm behind it.

    Args:
        arm: the arm that moves.
        station: the limits of its arm, and ``arm.start_tolerance_rad``, are used.
    """

    def __init__(self, arm: Arm, station: Station) -> None:
        self._arm, self._stops = arm, Stops()
        self._limits = limits_of(station)
        self._start_tolerance_rad = station.arm.start_tolerance_rad

    def connect(self) -> None:
        """Passed on."""
        self._arm.connect()

    def state(self) -> ArmState:
        """Passed on."""
        return self._arm.state()

    def execute(self, trajectory: Trajectory) -> Motion:
        """Check the trajectory against every limit and the arm's state, then play it.

        Raises:
            MotionRefused: nothing moved; the text names the limit, joint and time, or the joint that is elsewhere.
            ArmReflex: from the arm.
        """
        stopped = self._stops.asked()
        _require_limits(self._limits, trajectory)
        state = self._arm.state()
        _require_ready(state, trajectory, self._start_tolerance_rad)
        return unmoved(state, trajectory) if stopped() else self._arm.execute(trajectory)

    def stop(self) -> None:
        """Passed on unchecked. An arm that cannot take a stop is not moving, so no error is raised."""
        self._stops.stop()
        with suppress(CellError):
            self._arm.stop()

    def hold(self) -> None:
        """Passed on unchecked, like `stop`."""
        with suppress(CellError):
            self._arm.hold()

    def resume(self) -> None:
        """Passed on: the rest of the trajectory was checked with the whole."""
        self._arm.resume()

    def recover(self) -> None:
        """Passed on."""
        self._arm.recover()

    def close(self) -> None:
        """Passed on."""
        self._arm.close()


class HandGuard:
    """A `Hand` that refuses widths, speeds and forces beyond this hand's limits (``station.hand``)."""

    def __init__(self, hand: Hand, station: Station) -> None:
        self._hand, self._limits = hand, station.hand

    def connect(self) -> None:
        """Passed on."""
        self._hand.connect()

    def state(self) -> HandState:
        """Passed on."""
        return self._hand.state()

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Check ``width_m`` and ``speed_m_s``, then move. Raises: HandFault; nothing moved."""
        _require_within("width_m", width_m, 0.0, self._limits.max_width_m)
        _require_within("speed_m_s", speed_m_s, 0.0, self._limits.max_speed_m_s)
        return self._hand.move(width_m, speed_m_s)

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Check ``force_n`` and ``speed_m_s``, then grasp. Raises: HandFault; nothing moved."""
        _require_within("force_n", force_n, 0.0, self._limits.max_force_n)
        _require_within("speed_m_s", speed_m_s, 0.0, self._limits.max_speed_m_s)
        return self._hand.grasp(force_n, speed_m_s)

    def home(self) -> HandState:
        """Passed on."""
        return self._hand.home()

    def stop(self) -> None:
        """Passed on unchecked, like `Guard.stop`."""
        with suppress(CellError):
            self._hand.stop()

    def close(self) -> None:
        """Passed on."""
        self._hand.close()


def _require_within(name: str, value: float, lowest: float, highest: float) -> None:
    if not lowest <= value <= highest:  # written so that NaN fails
        raise HandFault(f"{name} = {value:g} is not between {lowest:g} and {highest:g}.", "See [hand] of the station.")


def _require_limits(limits: JointLimits, trajectory: Trajectory) -> None:
    if (count := len(trajectory.end_q_rad)) != limits.joints:
        what = f"The trajectory has {count} joints, and the arm of the station {limits.joints}."
        raise MotionRefused(what, "Plan it for this station.")
    if not np.isfinite(trajectory.raw_q_rad).all():
        raise MotionRefused("The trajectory has a joint position that is not a finite number.", "Plan it again.")
    report = limits.check(trajectory.filtered())
    if not report.ok:
        raise MotionRefused(report.describe(), "Plan the motion again; trajectories from `planning` keep every limit.")


def _require_ready(state: ArmState, trajectory: Trajectory, tolerance_rad: float) -> None:
    if len(state.q_rad) != len(trajectory.start_q_rad):
        what = f"The arm reports {len(state.q_rad)} joints, and the trajectory has {len(trajectory.start_q_rad)}."
        raise MotionRefused(what, "Does the station's [robot] describe the arm that its driver serves?")
    if state.mode is not ArmMode.IDLE:
        raise MotionRefused(
            f"The arm is not idle: it reports {state.mode.value}.", "Wait, stop it or recover it first."
        )
    if not (np.isfinite(state.q_rad).all() and np.isfinite(state.dq_rad_s).all()):
        raise MotionRefused("The arm reports a position or speed that is not a finite number.", "Restart its node.")
    away = np.abs(trajectory.start_q_rad - state.q_rad)
    if not (away <= tolerance_rad).all():
        joint = int(np.argmax(away))
        raise MotionRefused(
            f"The motion starts {away[joint]:.3f} rad away from where joint {joint + 1} is"
            f" (allowed: {tolerance_rad:.3f} rad).",
            "Plan it from the measured position.",
        )
