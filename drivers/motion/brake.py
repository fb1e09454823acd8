"""Brings moving joints to rest without a path to stay on, e.g. after an error in the middle of a motion."""

from __future__ import annotations

import numpy as np
import ruckig

from bus.arrays import JointSamples
from bus.errors import DriverError
from bus.trajectory import TICK_S
from config.limits import JointLimits

_SHARE = 0.98
"""Share of the limits that is used; the samples' differences lag the profile by a tick."""
_GENTLE_JERK = 0.25
_BEYOND = "The arm cannot be brought to rest within its limits."
_ADVICE = "The arm's own controller stops it now; find out what sent these commands."


def brake_without_path(limits: JointLimits, last_q_rad: JointSamples) -> JointSamples:
    """Return 1 kHz commands (m, n) [rad] from motion to rest, all joints at rest at the same time (ruckig).

    They follow no checked path: the arm runs on by up to dq^2 / 20. With a trajectory, use `drivers.motion.stream`.

    Args:
        limits: of the joints. ``last_q_rad``: (3, n) the last three commands.

    Raises:
        DriverError: the commands are not finite, or too fast to be braked within the limits.
    """
    if not np.isfinite(last_q_rad).all():
        raise DriverError("The last commands are not finite numbers: there is no state to brake from.", _ADVICE)
    q_rad, ddq_rad_s2 = last_q_rad[-1], np.diff(last_q_rad, n=2, axis=0)[0] / TICK_S**2
    dq_rad_s = (q_rad - last_q_rad[-2]) / TICK_S + ddq_rad_s2 * TICK_S / 2
    order = ruckig.InputParameter(limits.joints)
    order.control_interface = ruckig.ControlInterface.Velocity
    order.synchronization = ruckig.Synchronization.Time
    order.current_position, order.current_velocity = q_rad.tolist(), dq_rad_s.tolist()
    most_rad_s2 = _SHARE * limits.acceleration_rad_s2
    order.current_acceleration = np.clip(ddq_rad_s2, -most_rad_s2, most_rad_s2).tolist()
    order.target_velocity = [0.0] * limits.joints
    order.max_acceleration = most_rad_s2.tolist()
    order.max_jerk = (_GENTLE_JERK * limits.jerk_rad_s3).tolist()
    profile = ruckig.Trajectory(limits.joints)
    try:
        outcome = ruckig.Ruckig(limits.joints).calculate(order, profile)
    except ruckig.RuckigError as error:
        raise DriverError(_BEYOND, _ADVICE) from error
    if outcome != ruckig.Result.Working:
        raise DriverError(_BEYOND, _ADVICE)
    ticks = int(np.ceil(profile.duration / TICK_S)) + 1
    return np.array([profile.at_time(min(tick * TICK_S, profile.duration))[0] for tick in range(1, ticks)] or [q_rad])
