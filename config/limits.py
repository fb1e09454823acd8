"""Joint limits of an arm, and the 1 kHz check of a commanded motion against them; those of the Franka Research 3.

Of the FR3 two official sets exist and neither contains the other, so both are kept:

* A: libfranka ``rate_limiting.h`` (velocity) and franka_description ``fr3/joint_limits.yaml`` 1.0 (position);
* B: Franka's ``control-parameters-joint-fr3.csv``, for system images from 5.9 on.

Like libfranka, every limit is reduced by 1e-3 (`MARGIN`). `config.robot.limits_of` gives those of a station's arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples
from bus.trajectory import TICK_S

Array = npt.NDArray[np.float64]

MARGIN = 1e-3
"""Reduction of each limit, as in libfranka (``kLimitEps``), in the limit's own unit."""

_LOWER_A = np.array([-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159])
_UPPER_A = np.array([2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159])
_LOWER_B = np.array([-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508])
_UPPER_B = np.array([2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508])

_RANGE = np.maximum(_LOWER_A, _LOWER_B) + MARGIN, np.minimum(_UPPER_A, _UPPER_B) - MARGIN

SHOULDER_M = 0.333
"""Height of the axes of joints 1 and 2's crossing above the base (URDF)."""
REACH_M = 0.858
"""Farthest that the flange comes from there: the largest of 60 000 configurations drawn from the joints' range, half of
them with the elbow at its end. Franka's data sheet says 0.855."""

_SPEED_CAP = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
_BRAKING = np.array([12.0, 5.17, 7.0, 8.0, 34.0, 11.0, 34.0])  # 2 x braking deceleration [rad/s^2], both sets


@dataclass(frozen=True)
class _VelocitySet:
    """Parameters of ``v(q) = min(cap, sqrt(braking * (reference - q)) - offset)``; the references are no limits."""

    offset: Array
    lower: Array
    upper: Array


_VELOCITY_SETS = (
    _VelocitySet(  # A: libfranka rate_limiting.h
        np.array([0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35]),
        np.array([-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.5409, -3.0196]),
        np.array([2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196]),
    ),
    _VelocitySet(  # B: control-parameters-joint-fr3.csv
        np.array([0.6599, 0.2517, 0.2, 0.3533, 0.5757, 0.4878, 0.4628]), _LOWER_B, _UPPER_B
    ),
)


@dataclass(frozen=True)
class Peak:
    """The sample that comes nearest to one kind of limit.

    Attributes:
        ratio: value / limit; 1 = at the limit, inf = not finite.
        joint: from 1 on.
        t_s: time from the first sample.
    """

    ratio: float
    joint: int
    t_s: float


@dataclass(frozen=True)
class LimitReport:
    """The peak of a motion for each kind of limit."""

    position: Peak
    velocity: Peak
    acceleration: Peak
    jerk: Peak

    @property
    def worst(self) -> tuple[str, Peak]:
        """The kind of limit with the highest ratio, and its peak."""
        kinds = {k: getattr(self, k) for k in ("position", "velocity", "acceleration", "jerk")}
        return max(kinds.items(), key=lambda kind: kind[1].ratio)

    @property
    def ok(self) -> bool:
        """Whether every limit is kept."""
        return self.worst[1].ratio <= 1.0

    def describe(self) -> str:
        """Return one sentence for a person."""
        kind, peak = self.worst
        where = f"joint {peak.joint} at {peak.t_s:.3f} s"
        if not np.isfinite(peak.ratio):
            return f"The {kind} of {where} is not within any limit."
        verdict = "within" if self.ok else "over"
        return f"The {kind} of {where} is {verdict} its limit: {100 * peak.ratio:.1f} % of it."


class LimitShares(NamedTuple):
    """The share of each limit that a motion of n samples uses at 1 kHz, with its sign: -1 and 1 are the limits.

    Each is (m, joints) and covers the rest before and after: m = n + 6, n + 5, n + 4, n + 3. NaN is beyond any limit.
    """

    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    def of_samples(self) -> LimitShares:
        """Return the rows (n, joints) that belong to the samples."""
        samples = len(self.position) - 2 * _REST
        return LimitShares(*(rows[lead : lead + samples] for rows, lead in zip(self, _LEADS, strict=True)))


_REST = 3
_LEADS = (3, 2, 1, 0)
"""The row of each of `LimitShares` that belongs to the motion's first sample."""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """The limits of one arm's joints.

    Attributes:
        lower_rad, upper_rad: (n,) the range. ``speed_rad_s``, ``acceleration_rad_s2``, ``jerk_rad_s3``: (n,) at most.
        braking_rad_s2: (n,) twice the deceleration by which the speed falls towards the ends of the range, for the
            ``velocity_sets``, each of which counts; without any the speed is the same everywhere inside the range.
    """

    lower_rad: Joints
    upper_rad: Joints
    speed_rad_s: Joints
    acceleration_rad_s2: Joints
    jerk_rad_s3: Joints
    braking_rad_s2: Joints
    velocity_sets: tuple[_VelocitySet, ...] = ()

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.lower_rad)

    def velocity_bounds(self, q_rad: Array) -> tuple[Array, Array]:
        """Return the velocities (lower <= 0, upper >= 0) [rad/s] allowed at ``q_rad`` (..., n); 0 at the limits."""
        upper = np.broadcast_to(self.speed_rad_s, np.shape(q_rad))
        lower = -upper
        for s in self.velocity_sets:
            upper = np.minimum(upper, np.sqrt(np.maximum(0.0, self.braking_rad_s2 * (s.upper - q_rad))) - s.offset)
            lower = np.maximum(lower, s.offset - np.sqrt(np.maximum(0.0, self.braking_rad_s2 * (q_rad - s.lower))))
        return np.minimum(0.0, lower + MARGIN), np.maximum(0.0, upper - MARGIN)

    def outside(self, q_rad: Array) -> str | None:
        """Name the joint of ``q_rad`` (m, n) or (n,) that is farthest outside its range; None if none is."""
        beyond = np.atleast_2d(np.maximum(self.lower_rad - q_rad, q_rad - self.upper_rad))
        row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, joint] <= 0:
            return None
        value = np.atleast_2d(q_rad)[row, joint]
        range_rad = f"{self.lower_rad[joint]:.3f}..{self.upper_rad[joint]:.3f}"
        return f"joint {joint + 1} at {value:.3f} rad is outside its range {range_rad}"

    def stuck(self, q_rad: Joints) -> str | None:
        """Name the joint of ``q_rad`` (n,) so near its limit that no speed is allowed towards it; None if none is."""
        room_rad_s = np.minimum(*np.abs(self.velocity_bounds(q_rad)))
        joint = int(np.argmin(room_rad_s))
        if room_rad_s[joint] > 0:
            return None
        return f"joint {joint + 1} at {q_rad[joint]:.4f} rad is too near its limit: no speed is allowed there"

    def check(self, q_rad: JointSamples) -> LimitReport:
        """Check commanded positions at 1 kHz as libfranka does: by backward differences, from rest and back to rest.

        Args:
            q_rad: (m, n), m >= 1, one row every `TICK_S`.
        """
        return LimitReport(*map(_peak, self.shares(q_rad), _LEADS))

    def shares(self, q_rad: JointSamples) -> LimitShares:
        """Return the shares that commanded positions (m, n) [rad] use: backward differences, from rest to rest."""
        padded = np.concatenate([np.repeat(q_rad[:1], _REST, axis=0), q_rad, np.repeat(q_rad[-1:], _REST, axis=0)])
        velocity = np.diff(padded, axis=0) / TICK_S
        acceleration = np.diff(velocity, axis=0) / TICK_S
        jerk = np.diff(acceleration, axis=0) / TICK_S
        lower, upper = self.velocity_bounds(padded[1:])
        bound = np.where(velocity > 0, upper, -lower)
        with np.errstate(divide="ignore", invalid="ignore"):  # far outside the range the bound is NaN: too fast
            velocity_share = np.where(velocity == 0, 0.0, velocity / bound)
        return LimitShares(
            self.position_share(padded),
            velocity_share,
            acceleration / self.acceleration_rad_s2,
            jerk / self.jerk_rad_s3,
        )

    def position_share(self, q_rad: Array) -> Array:
        """Return where positions (..., n) [rad] lie in the joints' ranges: 0 in the middle, -1 and 1 at the limits."""
        middle, half = (self.upper_rad + self.lower_rad) / 2, (self.upper_rad - self.lower_rad) / 2
        return np.asarray((q_rad - middle) / half)


def _peak(share: Array, lead: int) -> Peak:
    """Return the largest of ``share`` (m, joints), whose row ``lead`` belongs to the motion's first sample."""
    ratio = np.where(np.isnan(share), np.inf, np.abs(share))
    row, column = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    return Peak(float(ratio[row, column]), int(column) + 1, max(0, int(row) - lead) * TICK_S)


FR3 = JointLimits(
    *_RANGE,
    _SPEED_CAP,
    np.full(7, 10.0) - MARGIN,  # sets A and B agree
    np.full(7, 5000.0) - MARGIN,  # sets A and B agree
    _BRAKING,
    _VELOCITY_SETS,
)
"""The Franka Research 3."""

LOWER_RAD, UPPER_RAD = FR3.lower_rad, FR3.upper_rad
ACCELERATION_RAD_S2, JERK_RAD_S3 = FR3.acceleration_rad_s2, FR3.jerk_rad_s3
velocity_bounds, outside, stuck = FR3.velocity_bounds, FR3.outside, FR3.stuck
check, limit_shares, position_share = FR3.check, FR3.shares, FR3.position_share
