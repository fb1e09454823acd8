"""The time of an episode: that of the arm while it moves, else that of the wall."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bus import topics
from bus.codec import decode
from bus.messages import Motion
from bus.trajectory import TICK_S
from logs.mcap.migrate import Content

Array = npt.NDArray[Any]


class Played(NamedTuple):
    """One motion of the arm. ``began_ns``, ``ended_ns``: when the cell asked for it and heard that it was over, UTC."""

    began_ns: int
    ended_ns: int
    motion: Motion

    @property
    def lasted_s(self) -> float:
        """By the arm's own ticks, rests on a hold included."""
        return len(self.motion.commanded_q_rad) * TICK_S


def played(content: Content) -> Iterator[Played]:
    """Yield the arm's motions in order of time; one that was refused or broke off has no answer, and is left out."""
    asked = [(at_ns, None) for at_ns, _ in content.payloads.get(f"{topics.ARM_EXECUTE.key}/query", [])]
    answered = content.payloads.get(f"{topics.ARM_EXECUTE.key}/reply", [])
    began_ns = None
    for at_ns, payload in sorted([*asked, *answered], key=lambda said: said[0]):
        if payload is None:
            began_ns = at_ns
        elif began_ns is not None:
            yield Played(began_ns, at_ns, decode(Motion, payload))
            began_ns = None


class EpisodeClock:
    """Converts times of the wall [ns UTC] to times of an episode [s], and back.

    While the arm plays a motion, the episode's time is the motion's own: a simulation that runs faster or slower than
    the wall so gives the same episode as a robot. Between motions it is the wall's.

    Args:
        start_ns: where the episode begins. ``motions``: in the order of time; what began before the start is not used.
    """

    def __init__(self, start_ns: int, motions: Sequence[Played]) -> None:
        self._start_ns = start_ns
        wall_s, time_s = [0.0], [0.0]
        for one in motions:
            began_s, ended_s = (one.began_ns - start_ns) / 1e9, (one.ended_ns - start_ns) / 1e9
            if began_s < wall_s[-1]:
                continue
            began_at_s = time_s[-1] + began_s - wall_s[-1]
            wall_s += [began_s, ended_s]
            time_s += [began_at_s, began_at_s + one.lasted_s]
        self._wall_s, self._time_s = np.array(wall_s), np.array(time_s)

    def time_s(self, at_ns: Array | Sequence[int] | int) -> Array:
        """Times of the episode [s]; negative before its start."""
        wall_s = (np.asarray(at_ns, np.int64) - self._start_ns) / 1e9
        return _along(wall_s, self._wall_s, self._time_s)

    def utc_ns(self, time_s: Array) -> Array:
        """Times of the wall [ns UTC]; those of a motion are spread evenly over it."""
        wall_s = _along(np.asarray(time_s, np.float64), self._time_s, self._wall_s)
        return self._start_ns + np.rint(wall_s * 1e9).astype(np.int64)


def _along(values: Array, knots: Array, images: Array) -> Array:
    """Interpolate between the knots; outside of them, one second is one second."""
    inside = np.interp(values, knots, images)
    return np.asarray(inside + np.minimum(values - knots[0], 0.0) + np.maximum(values - knots[-1], 0.0))
