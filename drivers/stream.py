"""Plays a trajectory tick by tick and brakes on its path; one for every arm.

The *raw* samples are switched and the moving average runs behind the switch: whatever the switch does within the
acceleration limits, the average turns into bounded jerk, and the commands never leave the checked path.
"""

from __future__ import annotations

import threading

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints
from bus.trajectory import TICK_S, Trajectory
from config.limits import ACCELERATION_RAD_S2

Array = npt.NDArray[np.float64]

_BRAKE_STEP = 0.99 * ACCELERATION_RAD_S2 * TICK_S**2
"""Second difference of the raw stream that a brake may use [rad]."""
_MAX_RATE_LOSS = 0.125
"""Largest loss of progress rate in one tick: even a motion that has hardly begun stops over 8 ticks."""


class Stream:
    """The 1 kHz commands of one trajectory.

    Unbraked, the commands are ``trajectory.filtered()``. A brake lowers the progress rate (raw samples a tick) from
    1 to 0 as fast as every joint's acceleration limit allows.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._path = _Path(trajectory.raw_q_rad)
        self._average = _MovingAverage(trajectory.start_q_rad, trajectory.window)
        self._brake_asked = threading.Event()
        self._braking = False
        self._rate = 1.0
        self._progress = -1.0  # raw samples; the first tick brings it to 0
        self._gap = np.zeros(7)  # from the smooth path to the raw sample at which the brake took hold
        self._rest_ticks = trajectory.window - 1  # left for the average to run empty
        self._over = False
        self._hold_asked = threading.Event()
        self._resting: Joints | None = None
        self.held = False

    @property
    def finished(self) -> bool:
        """Whether the trajectory was played to its end, without a brake."""
        return self._over and not self._braking

    def brake(self) -> None:
        """Stop on the path, now. May be called from any thread, and more than once."""
        self._brake_asked.set()

    def hold(self) -> None:
        """Wait on the path from the next tick on."""
        self._hold_asked.set()

    def resume(self) -> None:
        """Go on to the end."""
        self._hold_asked.clear()

    def next(self) -> Joints | None:
        """The next command, one tick after the last; None once at rest, at the end or after a brake."""
        braked = self._brake_asked.is_set()
        if self.held and braked:
            self._over = self._braking = True
        self.held = self._hold_asked.is_set() and not braked and not self._over and self._resting is not None
        if not self.held:
            self._resting = self._next()
        return self._resting

    def _next(self) -> Joints | None:
        if self._over:
            return None
        if self._at_rest:
            if self._rest_ticks == 0:
                self._over = True
                return None
            self._rest_ticks -= 1
            return self._average.again()
        if self._brake_asked.is_set() and not self._braking and self._progress >= 0:
            self._begin_brake()
        return self._average.push(self._braked_sample() if self._braking else self._next_sample())

    @property
    def _at_rest(self) -> bool:
        if self._progress < 0:
            return False
        return self._rate == 0.0 or self._progress >= (self._path.end if self._braking else self._path.last)

    def _next_sample(self) -> Joints:
        self._progress += 1.0
        return np.asarray(self._path.samples[int(self._progress)])

    def _begin_brake(self) -> None:
        self._braking = True
        self._gap = self._path.samples[int(self._progress)] - self._path.at(self._progress)

    def _braked_sample(self) -> Joints:
        loss = self._path.rate_loss(self._progress, self._rate)
        rate = max(0.0, self._rate - loss)
        self._progress = min(self._progress + (self._rate + rate) / 2, self._path.end)
        self._rate = rate
        return self._path.at(self._progress) + rate * self._gap


class _Path:
    """Raw samples as a smooth curve of the progress: the quadratic B-spline whose control points they are.

    Its second derivative is everywhere a second difference of the samples, so it is bounded exactly as they are; it
    passes them at an eighth of a second difference (about 1e-6 rad).
    """

    def __init__(self, samples: Array) -> None:
        self.samples = samples
        self.last = len(samples) - 1
        self.end = self.last + 0.5  # where the curve comes to rest
        self._padded = np.concatenate([samples[:1], samples[:1], samples, samples[-1:], samples[-1:], samples[-1:]])

    def _piece(self, progress: float) -> tuple[int, float]:
        """The sample nearest to ``progress``, and the offset from it in [-0.5, 0.5)."""
        nearest = int(np.floor(progress + 0.5))
        return nearest, progress - nearest

    def _derivatives(self, nearest: int) -> tuple[Array, Array, Array]:
        before, here, after = self._padded[nearest + 1 : nearest + 4]
        return here + (before - 2 * here + after) / 8, (after - before) / 2, before - 2 * here + after

    def at(self, progress: float) -> Joints:
        nearest, offset = self._piece(progress)
        position, slope, bend = self._derivatives(nearest)
        return np.asarray(position + slope * offset + bend * offset**2 / 2)

    def rate_loss(self, progress: float, rate: float) -> float:
        """The largest loss of rate in the tick that begins at ``progress``: no joint may exceed `_BRAKE_STEP`.

        The acceleration is ``slope * loss + bend * rate**2``. Slopes are linear and bends constant between
        half-samples, so the pieces' ends inside the tick cover all of it.
        """
        stop = min(progress + rate, self.end)
        loss = min(_MAX_RATE_LOSS, rate)
        for nearest in range(self._piece(progress)[0], self._piece(stop)[0] + 1):
            _, slope, bend = self._derivatives(nearest)
            for edge in (max(progress, nearest - 0.5), min(stop, nearest + 0.5)):
                loss = min(loss, _rate_loss_at(slope + bend * (edge - nearest), bend, rate))
        return max(0.0, loss)


def _rate_loss_at(slope: Array, bend: Array, rate: float) -> float:
    """Largest loss that keeps ``|bend * r**2 - slope * loss| <= _BRAKE_STEP`` for every rate r the tick may have."""
    speed = np.maximum(np.abs(slope), 1e-12)
    slowest = max(0.0, rate - _MAX_RATE_LOSS)
    drive = np.sign(slope) * bend  # > 0: the path itself speeds this joint up
    return float(((_BRAKE_STEP + np.minimum(drive * rate**2, drive * slowest**2)) / speed).min())


class _MovingAverage:
    """A box filter of ``window`` samples, full of ``start`` at first. Sums offsets from it, to keep all digits."""

    def __init__(self, start: Joints, window: int) -> None:
        self._start = start
        self._offsets = np.zeros((window, 7))
        self._total = np.zeros(7)
        self._newest = 0

    def push(self, sample: Joints) -> Joints:
        offset = sample - self._start
        self._newest = (self._newest + 1) % len(self._offsets)
        self._total += offset - self._offsets[self._newest]
        self._offsets[self._newest] = offset
        return np.asarray(self._start + self._total / len(self._offsets))

    def again(self) -> Joints:
        """Push the newest sample once more."""
        return self.push(self._start + self._offsets[self._newest])
