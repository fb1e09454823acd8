"""Compares the motions of two cycles, segment by segment, at the same time since each segment's start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from bus.codec import Json
from bus.messages import Delivery, Execution, SegmentRun
from bus.trajectory import TICK_S
from logs.mcap.reader import CycleRecord

_APART_RAD = 1e-3
"""Joints that are commanded farther apart than this are at another place: a millimetre at the tcp."""

Array = npt.NDArray[np.float64]
Named = dict[tuple[str, int], SegmentRun]


@dataclass(frozen=True)
class MotionRow:
    """One segment of both cycles; None where one of them lacks it.

    Attributes:
        segment: its name; a second one of the same name has a number.
        a_s, b_s: commanded durations. ``apart_from_s``: when the commanded joints part; None: they never do.
        apart_rad, joint: the largest commanded distance, and whose joint (from 1).
        torque_nm, torque_at_s: the largest difference of the torques from outside, and when.
        hand_m: difference of the hand's width after it, B - A.
    """

    segment: str
    a_s: float | None
    b_s: float | None
    apart_from_s: float | None = None
    apart_rad: float = 0.0
    joint: int = 0
    torque_nm: float = 0.0
    torque_at_s: float = 0.0
    hand_m: float = 0.0

    def to_json(self) -> Json:
        """Return the fields as a JSON object."""
        return asdict(self)

    def in_words(self) -> str:
        """One line for a person."""
        if self.a_s is None or self.b_s is None:
            return "only in B" if self.a_s is None else "only in A"
        parted = (
            "the same motion"
            if self.apart_from_s is None
            else f"apart from {self.apart_from_s:.2f} s on, by up to {self.apart_rad:.3f} rad (joint {self.joint})"
        )
        lasts = "" if abs(self.a_s - self.b_s) < TICK_S else f", {self.a_s:.2f} -> {self.b_s:.2f} s"
        load = f"; load apart by up to {self.torque_nm:.2f} Nm at {self.torque_at_s:.2f} s"
        return f"{parted}{lasts}{load}; hand {self.hand_m * 1e3:+.1f} mm"


def compare_motion(a: CycleRecord, b: CycleRecord) -> list[MotionRow]:
    """A row for every segment that either cycle played, in the order of A, then what only B has."""
    in_a, in_b = named_runs(a), named_runs(b)
    return [_row(key, in_a.get(key), in_b.get(key)) for key in dict.fromkeys([*in_a, *in_b])]


def named_runs(record: CycleRecord) -> Named:
    """Return the played segments by name and number of the name, in the order they ran."""
    seen: Counter[str] = Counter()
    named: Named = {}
    for run in _runs(record):
        named[run.name, seen[run.name]] = run
        seen[run.name] += 1
    return named


def torque_nm(run: SegmentRun) -> Array:
    """Return the largest torque from outside on any joint, of each measured sample (n,)."""
    largest: Array = np.abs(run.motion.tau_ext_nm).max(axis=1, initial=0.0)
    return largest


def _runs(record: CycleRecord) -> Iterator[SegmentRun]:
    for stage in record.stages.values():
        if isinstance(stage.result, Execution | Delivery):
            yield from (run for run in stage.result.runs if len(run.motion.commanded_q_rad) and len(run.motion.t_s))


def _row(key: tuple[str, int], a: SegmentRun | None, b: SegmentRun | None) -> MotionRow:
    name = key[0] if not key[1] else f"{key[0]} {key[1] + 1}"
    a_s, b_s = (len(run.motion.commanded_q_rad) * TICK_S if run is not None else None for run in (a, b))
    if a is None or b is None:
        return MotionRow(name, a_s, b_s)
    common = min(len(a.motion.commanded_q_rad), len(b.motion.commanded_q_rad))
    apart_rad = np.abs(a.motion.commanded_q_rad[:common] - b.motion.commanded_q_rad[:common])
    parted = np.flatnonzero(apart_rad.max(axis=1) > _APART_RAD)
    joint = int(np.unravel_index(int(apart_rad.argmax()), apart_rad.shape)[1]) + 1
    at_s, difference_nm = _torque_difference(a, b)
    most = int(difference_nm.argmax())
    return MotionRow(
        name,
        a_s,
        b_s,
        apart_from_s=float(parted[0]) * TICK_S if len(parted) else None,
        apart_rad=float(apart_rad.max()),
        joint=joint,
        torque_nm=float(difference_nm[most]),
        torque_at_s=float(at_s[most]),
        hand_m=b.hand.width_m - a.hand.width_m,
    )


def _torque_difference(a: SegmentRun, b: SegmentRun) -> tuple[Array, Array]:
    """Times [s] that both segments have, and how far their torques from outside are apart there [Nm]."""
    end_s = min(float(a.motion.t_s[-1]), float(b.motion.t_s[-1]))
    at_s = a.motion.t_s[a.motion.t_s <= end_s]
    at_s = at_s if len(at_s) else a.motion.t_s[:1]
    ours, theirs = (np.interp(at_s, run.motion.t_s, torque_nm(run)) for run in (a, b))
    return at_s, np.abs(ours - theirs)
