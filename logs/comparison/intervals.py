"""Confidence intervals of rates, of the difference of two rates, and of the difference of two medians."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

LEVEL = 0.95
_Z = float(norm.ppf(0.5 + LEVEL / 2))
_RESAMPLES = 2000


class Interval(NamedTuple):
    """An estimate with the bounds of its 95 % confidence interval."""

    value: float
    low: float
    high: float

    @property
    def excludes_zero(self) -> bool:
        """True when the sign of a difference is certain at this level."""
        return self.low > 0 or self.high < 0


def rate(part: int, whole: int) -> Interval | None:
    """Return the rate ``part / whole`` with Wilson's interval; None of nothing."""
    if whole == 0:
        return None
    share, z2 = part / whole, _Z**2
    middle = (share + z2 / (2 * whole)) / (1 + z2 / whole)
    half = _Z / (1 + z2 / whole) * math.sqrt(share * (1 - share) / whole + z2 / (4 * whole**2))
    return Interval(share, min(max(0.0, middle - half), share), max(min(1.0, middle + half), share))


def rate_difference(before: Interval | None, after: Interval | None) -> Interval | None:
    """``after - before`` of two rates of independent picks, with Newcombe's interval (1998, method 10)."""
    if before is None or after is None:
        return None
    value = after.value - before.value
    low = value - math.hypot(after.value - after.low, before.high - before.value)
    high = value + math.hypot(after.high - after.value, before.value - before.low)
    return Interval(value, low, high)


def median_difference(before: Sequence[float], after: Sequence[float]) -> Interval | None:
    """``median(after) - median(before)`` with the percentile bootstrap's interval, the same at every call."""
    if not before or not after:
        return None
    rng = np.random.default_rng(0)
    found = [
        np.median(rng.choice(np.asarray(values, float), (_RESAMPLES, len(values))), axis=1)
        for values in (before, after)
    ]
    low, high = np.percentile(found[1] - found[0], [50 * (1 - LEVEL), 50 * (1 + LEVEL)])
    value = float(np.median(after) - np.median(before))
    return Interval(value, min(float(low), value), max(float(high), value))


def picks_needed(before: float, after: float) -> int:
    """Picks of each side that tell two rates apart: 95 % level, 80 % power; for planning the next trial."""
    if before == after:
        return 0
    z = _Z + float(norm.ppf(0.8))
    return math.ceil(z**2 * (before * (1 - before) + after * (1 - after)) / (after - before) ** 2)
