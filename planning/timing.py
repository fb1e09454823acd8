"""From a joint path to a trajectory: as fast as the limits allow, jerk-bounded, judged before it is given out.

Time-optimal parametrisation (toppra: Pham & Pham, "A New Approach to Time-Optimal Path Parameterization Based on
Reachability Analysis", T-RO 2018) bounds velocity and acceleration; the moving average that the trajectory is played
through bounds jerk by ``2 a_max / window``. Both the raw and the filtered samples must pass `config.limits.check`;
time is stretched until they do. The raw ones matter too: a brake starts from them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import toppra
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint

from bus.arrays import Joints, JointSamples
from bus.codes import Code
from bus.errors import CycleFailure
from bus.trajectory import TICK_S, Trajectory, moving_average
from config.limits import ACCELERATION_RAD_S2, LimitReport, check, outside, velocity_bounds
from config.schema import Station
from planning.path import first_collision
from planning.robot import Robot

Array = npt.NDArray[np.float64]

_GRID = 301
_VELOCITY_SHARE = 0.998  # position-dependent limits are not convex over the filter's window
_ACCELERATION_SHARE = 0.99
_TINY_RAD = 1e-5
_TINY_TICKS = 20
_STRETCH_ROUNDS = 8


def move(robot: Robot, q_from_rad: Joints, q_to_rad: Joints) -> Trajectory:
    """A straight joint move from rest to rest, with the hand as wide as it may be.

    Raises:
        CycleFailure: COLLISION, naming what is touched; MOTION_REFUSED outside the limits.
    """
    return gated(robot, np.stack([q_from_rad, q_to_rad]), width_m=None)


def hold(q_rad: Joints, duration_s: float) -> Trajectory:
    """Stay at ``q_rad`` for ``duration_s``."""
    samples = max(1, round(duration_s / TICK_S) + 1)
    return Trajectory(raw_q_rad=np.repeat(np.asarray(q_rad, dtype=float)[None], samples, axis=0), window=1)


def gated(robot: Robot, points_rad: JointSamples, *, width_m: float | None) -> Trajectory:
    """Time a path, then judge the commands that would really be sent, independently of how they were planned.

    Raises:
        CycleFailure: COLLISION or MOTION_REFUSED.
    """
    if not np.isfinite(points_rad).all():
        raise CycleFailure(Code.MOTION_REFUSED, "The path has a joint position that is not a finite number.")
    trajectory = timed(robot.station, points_rad)
    touch = first_collision(robot, trajectory.filtered(), width_m=width_m)
    if touch is not None:
        raise CycleFailure(Code.COLLISION, f"On the way, {touch}.")
    return trajectory


def timed(station: Station, points_rad: JointSamples) -> Trajectory:
    """The fastest trajectory within the limits through ``points_rad`` (m, 7), which lie on a smooth curve.

    Raises:
        CycleFailure: MOTION_REFUSED when the path leaves the position limits or cannot be timed within the others.
    """
    beyond = outside(points_rad)
    if beyond is not None:
        raise CycleFailure(Code.MOTION_REFUSED, f"The path leaves the limits: {beyond}.")
    window = station.planning.window_ms
    steps_rad = np.abs(np.diff(points_rad, axis=0)).max(axis=1)
    at = np.concatenate([[0.0], np.cumsum(steps_rad)])
    length_rad = float(at[-1])
    if length_rad == 0.0:
        return _accepted(points_rad[:1], window)
    if length_rad < _TINY_RAD:
        share = np.linspace(0.0, 1.0, _TINY_TICKS)[:, None]
        return _accepted(points_rad[0] + share * (points_rad[-1] - points_rad[0]), window)
    path = toppra.SplineInterpolator(at, points_rad, bc_type="not-a-knot")
    profile = _fastest(path, length_rad, station.arm.speed)
    stretch = 1.0
    for _ in range(_STRETCH_ROUNDS):
        raw = _sampled(profile, points_rad, stretch)
        of_raw, of_filtered = check(raw), check(moving_average(raw, window))
        over = max(_excess(of_raw, jerk=False), _excess(of_filtered, jerk=True))
        if over <= 1.0:
            return Trajectory(raw_q_rad=raw, window=window)
        if not np.isfinite(over):
            break
        stretch *= 1.0005 * over
    raise CycleFailure(Code.MOTION_REFUSED, f"The path cannot be timed. {of_filtered.describe()}")


def _accepted(raw_q_rad: JointSamples, window: int) -> Trajectory:
    trajectory = Trajectory(raw_q_rad=raw_q_rad, window=window)
    report = check(trajectory.filtered())
    if not report.ok:
        raise CycleFailure(Code.MOTION_REFUSED, report.describe())
    return trajectory


def _excess(report: LimitReport, *, jerk: bool) -> float:
    """The factor by which time must be stretched to bring velocity, acceleration (and jerk) within their limits."""
    return max(
        report.velocity.ratio,
        float(np.sqrt(report.acceleration.ratio)),
        float(np.cbrt(report.jerk.ratio)) if jerk else 0.0,
    )


def _sampled(profile: Any, points_rad: JointSamples, stretch: float) -> JointSamples:
    """1 kHz samples of ``profile``, slowed by ``stretch``; the ends are the path's ends exactly."""
    ticks = max(1, int(np.ceil(profile.duration * stretch / TICK_S)))
    raw = np.array(profile(np.linspace(0.0, profile.duration, ticks + 1)))
    raw[0], raw[-1] = points_rad[0], points_rad[-1]
    return raw


def _fastest(path: Any, length_rad: float, speed: float) -> Any:
    """The time-optimal profile along ``path``; ``speed`` < 1 scales its time by 1 / speed."""
    limit = (_ACCELERATION_SHARE * speed**2 * ACCELERATION_RAD_S2)[:, None] * np.array([-1.0, 1.0])
    acceleration = JointAccelerationConstraint(limit, discretization_scheme=DiscretizationType.Interpolation)
    velocity = _PositionDependentVelocity(_VELOCITY_SHARE * speed)
    solver = toppra.algorithm.TOPPRA(
        [velocity, acceleration],
        path,
        gridpoints=np.linspace(0.0, length_rad, _GRID),
        solver_wrapper="seidel",
        parametrizer="ParametrizeConstAccel",
    )
    with np.errstate(divide="ignore", invalid="ignore"):  # where no velocity is left at all
        profile = solver.compute_trajectory(0.0, 0.0)
    if profile is None or not np.isfinite(profile.duration):
        raise CycleFailure(Code.MOTION_REFUSED, "The path cannot be followed within the joint limits.")
    return profile


class _PositionDependentVelocity(LinearConstraint):  # type: ignore[misc]
    """`config.limits.velocity_bounds` as a bound on the squared path speed at each grid point."""

    def __init__(self, share: float) -> None:
        super().__init__()
        self._share = share
        self.identical = True

    def get_dof(self) -> int:
        return 7

    def compute_constraint_params(self, path: Any, gridpoints: Array, *_: Any) -> tuple[Any, ...]:
        lower, upper = velocity_bounds(path(gridpoints))
        slope = path(gridpoints, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            allowed = np.where(slope > 0, upper / slope, np.where(slope < 0, lower / slope, np.inf))
        fastest = np.minimum(self._share * allowed.min(axis=1), 1e4)
        return None, None, None, None, None, None, np.stack([np.zeros_like(fastest), fastest**2], axis=1)
