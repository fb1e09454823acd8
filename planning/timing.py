"""Times a joint path: makes the fastest trajectory that keeps every limit and bounds jerk.

Time-optimal parametrisation (toppra: Pham & Pham, "A New Approach to Time-Optimal Path Parameterization Based on
Reachability Analysis", T-RO 2018) bounds velocity and acceleration; the moving average that the trajectory is played
through bounds jerk by ``2 a_max / window``. Both the raw and the filtered samples must keep every limit
(`config.limits`); time is stretched until they do. The raw ones matter too: a brake starts from them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import ruckig

from bus.arrays import Joints, JointSamples
from bus.codes import Code
from bus.errors import CycleFailure
from bus.trajectory import MAX_SAMPLES, TICK_S, Trajectory, moving_average
from config.limits import JointLimits, LimitReport
from config.robot import limits_of
from config.schema import Station
from planning.blend import Curve, blended
from planning.lean_toppra import DiscretizationType, JointAccelerationConstraint, LinearConstraint, toppra
from planning.slow_end import SlowEnd

Array = npt.NDArray[np.float64]
Sampler = Callable[[Array], JointSamples]
"""Positions (n, joints) of a profile at its times (n,) [s]."""

_GRID = 121
_SLOW_GRID = 17
_LOOK_RAD = 0.002
_VELOCITY_SHARE = 0.998  # position-dependent limits are not convex over the filter's window
_ACCELERATION_SHARE = 0.997
_TINY_RAD = 1e-5
_TINY_TICKS = 20
_STRETCH_ROUNDS = 8
_LONGEST_STRETCH = 20.0
"""A profile that must be stretched by more is given up: it would only cost time and memory."""
_UNEVEN = 0.7
"""Where a joint's allowed velocity falls below this share of its median on the line, one constant speed is too slow."""
_STILL_RAD = 1e-12


def timed(station: Station, curve: Curve, *more: LinearConstraint, slow_end: SlowEnd | None = None) -> Trajectory:
    """Return the fastest trajectory within the limits along ``curve``, and no faster than ``slow_end`` at its end.

    Args:
        more: constraints besides the joints' own limits.

    Raises:
        CycleFailure: MOTION_REFUSED when the path leaves the position limits or cannot be timed within the others.
    """
    points_rad, length_rad = curve.points_rad, float(curve.at_rad[-1])
    limits = limits_of(station)
    _require_inside(limits, points_rad)
    _require_passable(limits, points_rad)
    if length_rad < _TINY_RAD:
        return _tiny(limits, points_rad[0], points_rad[-1], station.planning.window_ms)
    path = toppra.SplineInterpolator(curve.at_rad, points_rad, bc_type="not-a-knot")
    sampler, duration_s = _fastest(limits, path, length_rad, station.arm.speed, slow_end, more)
    return within_limits(limits, sampler, duration_s, (points_rad[0], points_rad[-1]), station.planning.window_ms)


def rest_to_rest(station: Station, q_from_rad: Joints, q_to_rad: Joints) -> Trajectory:
    """Return a straight joint line between two configurations (joints,), all joints in phase.

    It serves the move to the capture pose, and the one after a recovery. Ruckig times it at one speed, unless the line
    is slow at one place only: near a joint's limit.

    Raises:
        CycleFailure: MOTION_REFUSED outside the limits, or where no speed is allowed.
    """
    ends, limits = np.stack([q_from_rad, q_to_rad]), limits_of(station)
    _require_inside(limits, ends)
    if np.abs(ends[1] - ends[0]).max() < _TINY_RAD:
        return _tiny(limits, ends[0], ends[1], station.planning.window_ms)
    line = np.linspace(ends[0], ends[1], 101)
    _require_passable(limits, line)
    lower, upper = limits.velocity_bounds(line)
    allowed = np.where(ends[1] > ends[0], upper, -lower)[:, np.abs(ends[1] - ends[0]) > _STILL_RAD]
    if (allowed.min(axis=0) < _UNEVEN * np.median(allowed, axis=0)).any():
        return timed(station, blended([ends]))
    fastest = np.maximum(1e-3, np.where(ends[1] > ends[0], upper, -lower).min(axis=0))
    order = ruckig.InputParameter(limits.joints)
    order.current_position, order.target_position = ends[0].tolist(), ends[1].tolist()
    order.max_velocity = (_VELOCITY_SHARE * station.arm.speed * fastest).tolist()
    order.max_acceleration = (_ACCELERATION_SHARE * station.arm.speed**2 * limits.acceleration_rad_s2).tolist()
    order.max_jerk = limits.jerk_rad_s3.tolist()
    order.synchronization = ruckig.Synchronization.Phase
    profile = ruckig.Trajectory(limits.joints)
    if ruckig.Ruckig(limits.joints).calculate(order, profile) != ruckig.Result.Working:
        raise CycleFailure(Code.MOTION_REFUSED, "The move cannot be timed within the joint limits.")

    def sampler(times_s: Array) -> JointSamples:
        return np.array([profile.at_time(t)[0] for t in times_s])

    return within_limits(limits, sampler, profile.duration, (ends[0], ends[1]), station.planning.window_ms)


def _require_inside(limits: JointLimits, points_rad: JointSamples) -> None:
    if not len(points_rad):
        raise CycleFailure(Code.MOTION_REFUSED, "The path has no points.")
    if not np.isfinite(points_rad).all():
        raise CycleFailure(Code.MOTION_REFUSED, "The path has a joint position that is not a finite number.")
    beyond = limits.outside(points_rad)
    if beyond is not None:
        raise CycleFailure(Code.MOTION_REFUSED, f"The path leaves the limits: {beyond}.")


def _require_passable(limits: JointLimits, points_rad: JointSamples) -> None:
    """Raises: CycleFailure: MOTION_REFUSED where a joint has to move and its allowed speed is 0."""
    step_rad = np.diff(points_rad, axis=0)
    lower, upper = limits.velocity_bounds(points_rad[1:])
    barred = ((step_rad > _STILL_RAD) & (upper <= 0)) | ((step_rad < -_STILL_RAD) & (lower >= 0))
    if barred.any():
        row, joint = (int(index) for index in np.argwhere(barred)[0])
        raise CycleFailure(
            Code.MOTION_REFUSED,
            f"The path cannot be timed. The velocity of joint {joint + 1} would have to be 0 at "
            f"{points_rad[row + 1, joint]:.4f} rad, so near is its limit.",
        )


def _tiny(limits: JointLimits, q_from_rad: Joints, q_to_rad: Joints, window: int) -> Trajectory:
    """Return one sample for a goal already reached, and an even motion to one that is hardly away."""
    if np.array_equal(q_from_rad, q_to_rad):
        return Trajectory(raw_q_rad=q_from_rad[None], window=window)
    share = np.linspace(0.0, 1.0, _TINY_TICKS)[:, None]
    trajectory = Trajectory(raw_q_rad=q_from_rad + share * (q_to_rad - q_from_rad), window=window)
    report = limits.check(trajectory.filtered())
    if not report.ok:
        raise CycleFailure(Code.MOTION_REFUSED, report.describe())
    return trajectory


def within_limits(
    limits: JointLimits, sampler: Sampler, duration_s: float, ends: tuple[Joints, Joints], window: int
) -> Trajectory:
    """Return the profile at 1 kHz, slowed until its raw and its filtered samples keep every limit.

    Args:
        limits: of the joints. ``sampler``: positions of the profile at given times.
        duration_s: of the profile.
        ends: first and last position (joints,), kept exactly.
        window: length of the moving average [samples].

    Raises:
        CycleFailure: MOTION_REFUSED when that takes too long: never more than `MAX_SAMPLES` are made at a time, nor
            `_LONGEST_STRETCH` times as many as the profile has.
    """
    stretch, why = 1.0, ""
    for _ in range(_STRETCH_ROUNDS):
        if not duration_s * stretch < (MAX_SAMPLES - 2) * TICK_S or stretch > _LONGEST_STRETCH:
            why = why or f"It would take {duration_s * stretch:.0f} s."
            break
        ticks = max(1, int(np.ceil(duration_s * stretch / TICK_S)))
        raw = np.array(sampler(np.linspace(0.0, duration_s, ticks + 1)))
        raw[0], raw[-1] = ends
        of_raw, of_filtered = limits.check(raw), limits.check(moving_average(raw, window))
        over = max(_excess(of_raw, jerk=False), _excess(of_filtered, jerk=True))
        if over <= 1.0:
            return Trajectory(raw_q_rad=raw, window=window)
        why = max((of_raw, of_filtered), key=lambda report: report.worst[1].ratio).describe()
        if not np.isfinite(over):
            break
        stretch *= 1.0005 * over
    raise CycleFailure(Code.MOTION_REFUSED, f"The path cannot be timed. {why}")


def _excess(report: LimitReport, *, jerk: bool) -> float:
    """Return the factor by which time must be stretched to keep velocity, acceleration (and jerk) within limits."""
    return max(
        report.velocity.ratio,
        float(np.sqrt(report.acceleration.ratio)),
        float(np.cbrt(report.jerk.ratio)) if jerk else 0.0,
    )


def _fastest(
    limits: JointLimits,
    path: Any,
    length_rad: float,
    speed: float,
    slow_end: SlowEnd | None,
    more: Sequence[LinearConstraint] = (),
) -> tuple[Sampler, float]:
    """Return the time-optimal profile along ``path`` and its duration [s].

    ``speed`` < 1 scales its time by 1 / speed, but for that of ``slow_end``.

    Raises:
        CycleFailure: MOTION_REFUSED when the limits allow none.
    """
    limit = (_ACCELERATION_SHARE * speed**2 * limits.acceleration_rad_s2)[:, None] * np.array([-1.0, 1.0])
    acceleration = JointAccelerationConstraint(limit, discretization_scheme=DiscretizationType.Interpolation)
    velocity = PositionDependentVelocity(limits, _VELOCITY_SHARE * speed, slow_end)
    s = _grid(path, length_rad)
    if slow_end is not None:
        s = _denser_at_end(path, s, slow_end)
    solver = toppra.algorithm.TOPPRA([velocity, acceleration, *more], path, gridpoints=s, solver_wrapper="seidel")
    with np.errstate(divide="ignore", invalid="ignore"):  # where no velocity is left at all
        _, rate, _ = solver.compute_parameterization(0.0, 0.0)
        if rate is not None:
            step_s = 2 * np.diff(s) / (rate[1:] + rate[:-1])
    if rate is None or not np.isfinite(step_s).all():
        raise CycleFailure(Code.MOTION_REFUSED, "The path cannot be followed within the joint limits.")
    at_s = np.concatenate([[0.0], np.cumsum(step_s)])

    def sampler(times_s: Array) -> JointSamples:
        row = np.clip(np.searchsorted(at_s, times_s, side="right") - 1, 0, len(step_s) - 1)
        t, gain = times_s - at_s[row], (rate[row + 1] - rate[row]) / step_s[row]
        return np.asarray(path(np.clip(s[row] + rate[row] * t + gain * t**2 / 2, 0.0, length_rad)))

    return sampler, float(at_s[-1])


def _grid(path: Any, length_rad: float) -> Array:
    """Return grid points, denser where the path bends: half as many as an even grid needs for the same accuracy."""
    s = np.linspace(0.0, length_rad, 10 * _GRID)
    bend = np.sqrt(np.linalg.norm(path(s, 2), axis=1))
    density = bend / max(float(bend.mean()), 1e-12) + 0.3
    share = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return np.asarray(np.interp(np.linspace(0.0, share[-1], _GRID), share, s))


def _denser_at_end(path: Any, s: Array, slow_end: SlowEnd) -> Array:
    """Return the grid ``s`` (n,) with more points on each step of ``slow_end``."""
    ends, begins = [float(s[-1])], float(s[-1])
    for step in range(len(slow_end.steps)):
        while begins > _LOOK_RAD and slow_end.step_at(path(np.array([begins - _LOOK_RAD])))[0] <= step:
            begins -= _LOOK_RAD
        ends.insert(0, begins)
    dense = [np.linspace(one, other, _SLOW_GRID)[:-1] for one, other in pairwise(ends) if other > one]
    return np.concatenate([s[s < ends[0] - _LOOK_RAD], *dense, s[-1:]])


class PositionDependentVelocity(LinearConstraint):  # type: ignore[misc]
    """The allowed velocities, times ``share``, as a bound on the squared path speed at each grid point.

    The methods override those of toppra's ``LinearConstraint``.

    Args:
        slow_end: a bound on the tcp's speed besides.
    """

    def __init__(self, limits: JointLimits, share: float, slow_end: SlowEnd | None = None) -> None:
        super().__init__()
        self._limits, self._share, self._slow_end = limits, share, slow_end
        self.identical = True

    def get_dof(self) -> int:
        """Return the number of joints."""
        return self._limits.joints

    def compute_constraint_params(self, path: Any, gridpoints: Array, *_: Any) -> tuple[Any, ...]:
        """Return toppra's (a, b, c, F, g, ubound, xbound); only xbound is set: (n, 2) bounds of the squared path speed.

        Args:
            path: joint positions and derivatives by arc length.
            gridpoints: (n,) arc lengths [rad].
        """
        lower, upper = self._limits.velocity_bounds(path(gridpoints))
        slope = path(gridpoints, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            allowed = np.where(slope > 0, upper / slope, np.where(slope < 0, lower / slope, np.inf))
        fastest = np.minimum(self._share * allowed.min(axis=1), 1e4)
        if self._slow_end is not None:
            fastest = np.minimum(fastest, self._slow_end.path_speeds(path(gridpoints), slope))
        return None, None, None, None, None, None, np.stack([np.zeros_like(fastest), fastest**2], axis=1)
