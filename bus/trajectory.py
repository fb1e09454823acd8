"""A sampled joint trajectory: raw 1 kHz samples and the moving-average filter applied when it is played.

The planner makes the raw samples (velocity and acceleration bounded); the moving average turns them into
jerk-bounded ones (`|jerk| <= 2 a_max / (window dt)`). The player (`drivers.motion.stream`) switches the *raw* stream
and filters after the switch, so that a stop or resume is as smooth as the motion itself. Signs: docs/frames.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field, model_validator

from bus.arrays import Joints, JointSamples
from bus.frozen import Message
from bus.lazy import LazyModule

if TYPE_CHECKING:
    import numpy as np
else:
    np = LazyModule("numpy")

TICK_S = 0.001
"""The control period of the arm [s] (FCI, 1 kHz)."""
MAX_SAMPLES = 300_000
"""Five minutes: no motion of this arm is longer, and an incoming message must not fill the memory."""
MAX_WINDOW = 1000


def moving_average(samples: JointSamples, window: int) -> JointSamples:
    """Filter ``samples`` (m, n) with a causal box of ``window`` samples, at rest before and after.

    Returns:
        (m + window - 1, n): starts at the first and ends at the last sample exactly.
    """
    first, last = samples[0], samples[-1]
    padded = np.concatenate(
        [np.repeat(first[None], window - 1, axis=0), samples, np.repeat(last[None], window - 1, axis=0)]
    )
    total = np.cumsum(padded - first, axis=0)
    total[window:] -= total[:-window].copy()
    return np.asarray(first + total[window - 1 :] / window)


class ContactGuard(Message):
    """The last part of a motion, on which the arm stops when it meets something.

    The force against the motion is ``force_from_torque @ tau_ext``; contact is when it exceeds by ``limit_n`` what it
    was when the part began. A driver so needs no model of the arm, and compares at its own rate.

    Attributes:
        begins_at: the tick of the filtered motion from which it is felt, to the end.
        limit_n: the force.
        force_from_torque: (m, n) [1/m] for evenly spaced ticks of that part: the force on the tcp against the motion
            [N] for 1 Nm of external torque on each joint.
    """

    begins_at: Annotated[int, Field(ge=0)]
    limit_n: Annotated[float, Field(gt=0)]
    force_from_torque: JointSamples

    @model_validator(mode="after")
    def _check(self) -> ContactGuard:
        if not len(self.force_from_torque) or not np.isfinite(self.force_from_torque).all():
            raise ValueError("a contact guard needs finite weights of the torques, at least one row")
        return self


class Trajectory(Message):
    """A timed motion of all joints, at rest at both ends.

    Attributes:
        raw_q_rad: (m, n) positions every `TICK_S`, before the filter.
        window: length of the moving average [samples]; 1 = no filter.
        waits_at: the tick of the filtered motion before which the arm rests, held, unless it was resumed; None = none.
        guard: where and at which force it stops when it meets something; None = nowhere.
    """

    raw_q_rad: JointSamples
    window: int
    waits_at: Annotated[int, Field(ge=0)] | None = None
    guard: ContactGuard | None = None

    @model_validator(mode="after")
    def _check(self) -> Trajectory:
        if len(self.raw_q_rad) < 1 or self.window < 1:
            raise ValueError("a trajectory needs at least one sample and a window of at least 1")
        if len(self.raw_q_rad) > MAX_SAMPLES or self.window > MAX_WINDOW:
            raise ValueError(f"a trajectory has at most {MAX_SAMPLES} samples and a window of at most {MAX_WINDOW}")
        if not np.isfinite(self.raw_q_rad).all():
            raise ValueError("a trajectory must be finite")
        return self

    @property
    def start_q_rad(self) -> Joints:
        """Positions (n,) at the start."""
        return np.asarray(self.raw_q_rad[0])

    @property
    def end_q_rad(self) -> Joints:
        """Positions (n,) at the end."""
        return np.asarray(self.raw_q_rad[-1])

    @property
    def duration_s(self) -> float:
        """Duration of the filtered motion [s]."""
        return (len(self.raw_q_rad) + self.window - 2) * TICK_S

    def filtered(self) -> JointSamples:
        """Return the commanded positions (m, n), one every `TICK_S`."""
        return moving_average(self.raw_q_rad, self.window)
