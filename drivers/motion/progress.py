"""The progress of a motion along its samples, and the limits on the rate's change.

With q(s) the planned motion (s in ticks) and r = ds/dt the rate of progress, the acceleration is q' dr/dt + q'' r^2 and
the jerk q' d2r/dt2 + ...: both are kept by bounding dr/dt and its change, joint by joint, around the present tick.
"""

from __future__ import annotations

import copy

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import minimum_filter1d

from bus.arrays import Joints, JointSamples
from bus.trajectory import TICK_S
from config.limits import JointLimits

Array = npt.NDArray[np.float64]

_ACCELERATION_SHARE = 0.985
"""Of the least joint's limit, during a change of rate."""
_JERK_SHARE = 0.25
"""Of the least joint's limit, on a way back."""
_GO_BACK, _GO_BACK_JERK = 2 * 5.8, 2 * 60.0
"""Peak acceleration and jerk of a quintic over a unit distance in a unit time, doubled for the path's own bend."""
_ONSET = 1.5
"""Onset of a stop relative to the onset of the motion itself, which the moving average gives."""
_HARD_ONSET, _HARD_JERK_SHARE = 0.0625, 0.6
"""Of a brake at a contact: change of the rate's gain [per tick^2], and share of the least joint's jerk; the rest of the
jerk is the path's own. The blow is over after 3 to 5 ms: what brakes by then takes 1 N of 12 from it."""
_SHORTEST_WINDOW = 16
_AHEAD_TICKS = 128
"""Look-ahead, about the duration of a stop: the onset allowed at its end must be known from its start."""
_STILL = 1e-12


class Progress:
    """Place and rate of a motion. Undisturbed, the commands are the samples themselves, bit for bit.

    Args:
        limits: of the joints. ``samples_rad``: (m, n) 1 kHz commands, from rest to rest, within every limit.
        window: of the moving average they came from; it sets how smoothly a stop begins. With fewer than 16 samples the
            curve through them overshoots their acceleration by up to 0.6 %.
    """

    def __init__(self, limits: JointLimits, samples_rad: JointSamples, window: int) -> None:
        self._most = _ACCELERATION_SHARE * float(limits.acceleration_rad_s2.min()) * TICK_S**2  # [rad per tick^2]
        least_jerk = float(limits.jerk_rad_s3.min()) * TICK_S**3  # [rad per tick^3]
        self._most_jerk, self._hard_jerk = _JERK_SHARE * least_jerk, _HARD_JERK_SHARE * least_jerk
        self._samples = samples_rad
        self._last = len(samples_rad) - 1
        self._at = 0.0
        self._rate = 1.0
        self._gain = 0.0  # change of the rate in the last tick
        self._way_back: tuple[float, float, int, int] | None = None  # its start and end, its ticks, those done
        if self._last > 0:
            self._bounds(window)

    @property
    def at(self) -> float:
        """The place along the samples [ticks]."""
        return self._at

    @property
    def at_end(self) -> bool:
        """Whether the last sample is reached."""
        return self._at >= self._last

    @property
    def at_rest(self) -> bool:
        """Whether the motion rests, at its end or on its path."""
        return self._rate == 0.0 or self.at_end

    def q_rad(self) -> Joints:
        """Return the command (joints,) at this place."""
        tick = int(self._at)
        return np.asarray(self._samples[tick] if tick == self._at else self._curve(self._at))

    def advance(self, target_rate: float, *, hard: bool = False) -> None:
        """Advance one tick (1 ms), and move the rate towards ``target_rate`` (0 or 1) as fast as every joint allows.

        Args:
            hard: where the motion is slow, brake sooner than in a window: as soon as its jerk allows.
        """
        if self._rate == target_rate:
            self._at = min(self._at + self._rate, float(self._last))
            return
        if self._at == 0.0 and target_rate == 0.0:  # not begun yet
            self._rate = 0.0
            return
        gain = self._next_gain(target_rate, self._hard_onset if hard else self._onset)
        rate = self._rate + gain
        self._at = min(self._at + (self._rate + rate) / 2, float(self._last))
        arrived = abs(rate - target_rate) < _STILL
        self._rate, self._gain = (target_rate, 0.0) if arrived else (rate, gain)

    def go_back(self, to_at: float, by_rad: float) -> bool:
        """Go one tick of the way back, from rest to rest; False once there.

        Args:
            to_at: the place [ticks] before which it ends, ``by_rad`` of the joint that moves most.
        """
        if self._way_back is None:
            self._rate = self._gain = 0.0
            to_at = self._before(to_at, by_rad)
            far_rad = float(np.abs(self._curve(self._at) - self._curve(to_at)).max())
            longest = max(
                (_GO_BACK * far_rad / self._most) ** 0.5, (_GO_BACK_JERK * far_rad / self._most_jerk) ** (1 / 3)
            )
            self._way_back = (self._at, to_at, int(np.ceil(longest)), 0)
        from_at, to_at, ticks, done = self._way_back
        if done >= ticks:
            return False
        share = (done + 1) / ticks
        self._at = from_at + (to_at - from_at) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        self._way_back = (from_at, to_at, ticks, done + 1)
        return True

    def _before(self, at: float, by_rad: float) -> float:
        """Return the last place that is ``by_rad`` before ``at``, or the start."""
        away_rad = np.abs(self._samples[: int(at) + 1] - self._curve(at)).max(axis=1)
        return float(np.flatnonzero(away_rad >= by_rad)[-1]) if (away_rad >= by_rad).any() else 0.0

    def last_start_of_a_stop(self, before: int) -> float:
        """Return the last place [ticks] where a stop from full speed may begin that rests by the tick ``before``."""
        start = float(min(before, self._last))
        while start > 0.0:
            beyond = self._rest_after(start) - before
            if beyond <= 0.0:
                break
            start = max(0.0, np.floor(start - beyond))
        return start

    def _rest_after(self, start: float) -> float:
        """Return where a stop from full speed at ``start`` comes to rest."""
        trial = copy.copy(self)
        trial._at, trial._rate, trial._gain = start, 1.0, 0.0
        while not trial.at_rest:
            trial.advance(0.0)
        return trial._at

    def _next_gain(self, target_rate: float, onsets: Array) -> float:
        """Return the largest allowed step towards the target that can still fade out before it is reached."""
        tick = int(self._at)
        onset = onsets[tick]
        away = abs(target_rate - self._rate)
        fading = min(away, onset * (np.sqrt(0.25 + 2 * away / onset) - 0.5))
        wanted = max(self._gain - onset, -fading) if target_rate < self._rate else min(self._gain + onset, fading)
        low, high = self._gains(tick)
        return float(np.clip(np.clip(wanted, low, high), -self._rate, 1.0 - self._rate))

    def _gains(self, tick: int) -> tuple[float, float]:
        """Return the gains (<= 0, >= 0) with which no joint exceeds its acceleration from this tick to the next."""
        slope, bend = self._slope[tick : tick + 3], self._bend[tick : tick + 3]
        speed = np.maximum(np.abs(slope), 1e-15)
        drive = np.sign(slope) * bend * self._rate**2  # > 0: the path itself speeds this joint up
        low, high = (-self._most - drive) / speed, (self._most - drive) / speed
        return min(0.0, float(low.max())), max(0.0, float(high.min()))

    def _bounds(self, window: int) -> None:
        ticks = np.arange(self._last + 1)
        self._curve = CubicSpline(ticks, self._samples, bc_type="clamped")
        slope, bend = self._curve(ticks, 1), self._curve(ticks, 2)
        window = max(window, _SHORTEST_WINDOW)
        fastest = np.maximum(np.abs(slope).max(axis=1), 1e-15)

        def onsets(smoothest: float, jerk: float) -> Array:
            onset = np.minimum(smoothest, jerk / fastest)
            return np.asarray(minimum_filter1d(onset, _AHEAD_TICKS, origin=-(_AHEAD_TICKS // 2)))

        self._onset = onsets(_ONSET * 4 / window**2, _ONSET * 2 * self._most / window)
        self._hard_onset = onsets(_HARD_ONSET, self._hard_jerk)
        self._slope, self._bend = (np.concatenate([rows, np.repeat(rows[-1:], 2, axis=0)]) for rows in (slope, bend))
