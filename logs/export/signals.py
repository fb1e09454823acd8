"""Measured and commanded values as samples over the time of an episode, and their values at any time of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bus import topics
from bus.codec import decode
from bus.commands import HandMove
from bus.messages import HandState
from bus.sensor_codec import stamp_ns
from bus.trajectory import TICK_S
from logs.export.clock import Array, EpisodeClock, Played
from logs.export.selection import NothingToExport
from logs.mcap.migrate import Content
from logs.mcap.reader import CycleRecord, Stage

_FR3_JOINTS = 7
PRESS_WIDTH_M = 0.0
"""The commanded width of a grasp: the fingers close until they touch, and keep pressing."""


@dataclass(frozen=True)
class Samples:
    """Samples of one signal. ``time_s``: (n,) of the episode, ascending. ``values``: (n, d). ``utc_ns``: (n,)."""

    time_s: Array
    values: Array
    utc_ns: Array

    def between(self, at_s: Array) -> Array:
        """Return the values (m, d) at these times (m,), linear between two samples, held outside of them."""
        return np.stack([np.interp(at_s, self.time_s, column) for column in self.values.T], axis=-1)

    def latest(self, at_s: Array) -> Array:
        """Return the last values (m, d) at or before these times (m,); before the first sample, that one's."""
        return np.asarray(self.values[_last_at(self.time_s, at_s)])

    def latest_utc_ns(self, at_s: Array) -> Array:
        """Return when the sample (m,) of `latest` was taken [ns UTC]."""
        return np.asarray(self.utc_ns[_last_at(self.time_s, at_s)])

    def nearest_utc_ns(self, at_s: Array) -> Array:
        """Return when the nearest sample (m,) was taken [ns UTC]."""
        before = _last_at(self.time_s, at_s)
        after = np.minimum(before + 1, len(self.time_s) - 1)
        is_after = np.abs(self.time_s[after] - at_s) < np.abs(at_s - self.time_s[before])
        return np.asarray(self.utc_ns[np.where(is_after, after, before)])


def _last_at(time_s: Array, at_s: Array) -> Array:
    return np.maximum(np.searchsorted(time_s, np.asarray(at_s) + 1e-9, side="right") - 1, 0)


def _sorted(time_s: Array, values: Array, utc_ns: Array) -> Samples:
    order = np.argsort(time_s, kind="stable")
    return Samples(time_s[order], values[order], utc_ns[order])


def measured_joints(record: CycleRecord, motions: Sequence[Played], clock: EpisodeClock) -> Samples:
    """Positions [rad], velocities [rad/s] and external torques [Nm] of the joints: (n, 3 x joints).

    Of a motion every 10 ms as the arm measured it, else as it was published. Raises: NothingToExport without any.
    """
    published = _published(record)
    is_apart = np.ones(len(published.time_s), bool)
    times, values = [], []
    for one in motions:
        is_apart &= (published.utc_ns < one.began_ns) | (published.utc_ns > one.ended_ns)
        motion = one.motion
        times.append(clock.time_s(one.began_ns) + motion.t_s)
        values.append(np.hstack([motion.q_rad, motion.dq_rad_s, motion.tau_ext_nm]))
    if is_apart.any() or not times:
        times.append(clock.time_s(published.utc_ns[is_apart]))
        values.append(published.values[is_apart])
    time_s = np.concatenate(times)
    if not len(time_s):
        raise NothingToExport("It has no joint states.")
    return _sorted(time_s, np.concatenate(values), clock.utc_ns(time_s))


def _published(record: CycleRecord) -> Samples:
    """The states (n, 3 x joints) that the arm published; their ``time_s`` is not used."""
    rows = [
        [getattr(joint, name) for name in ("position", "velocity", "effort") for joint in said.message.joints]
        for said in record.arm
    ]
    stamps = np.array([stamp_ns(said.message.timestamp) for said in record.arm], np.int64)
    columns = len(rows[0]) if rows else 3 * _FR3_JOINTS
    return Samples(np.zeros(len(stamps)), np.array(rows, np.float64).reshape(-1, columns), stamps)


def commanded_joints(motions: Sequence[Played], clock: EpisodeClock, rest_q_rad: Array) -> Samples:
    """Positions (n, 7) [rad] as they were sent to the arm, one a tick; before the first motion ``rest_q_rad`` (7,)."""
    times, values = [np.array([-np.inf])], [rest_q_rad[None]]
    for one in motions:
        ticks = 1 + np.arange(len(one.motion.commanded_q_rad))
        times.append(clock.time_s(one.began_ns) + ticks * TICK_S)
        values.append(one.motion.commanded_q_rad)
    time_s = np.concatenate(times)
    return _sorted(time_s, np.concatenate(values), np.zeros(len(time_s), np.int64))


def measured_width(record: CycleRecord, content: Content, clock: EpisodeClock) -> Samples:
    """Distance (n, 1) [m] between the pads. Raises: NothingToExport without any."""
    answers = (topics.HAND_MOVE, topics.HAND_GRASP, topics.HAND_HOME)
    replies = [payload for topic in answers for _, payload in content.payloads.get(f"{topic.key}/reply", [])]
    said = [*(one.message for one in record.hand), *(decode(HandState, payload) for payload in replies)]
    if not said:
        raise NothingToExport("It has no states of the hand.")
    stamps = np.array([one.stamp_ns for one in said], np.int64)
    return _sorted(clock.time_s(stamps), np.array([[one.width_m] for one in said]), stamps)


def commanded_width(content: Content, clock: EpisodeClock, rest_m: Array) -> Samples:
    """Return the width (n, 1) [m] that the hand was told: `PRESS_WIDTH_M` from a grasp on, ``rest_m`` before all."""
    moves = content.payloads.get(f"{topics.HAND_MOVE.key}/query", [])
    grasps = content.payloads.get(f"{topics.HAND_GRASP.key}/query", [])
    told = [(at_ns, decode(HandMove, payload).width_m) for at_ns, payload in moves]
    told += [(at_ns, PRESS_WIDTH_M) for at_ns, _ in grasps]
    at_ns = np.array([at for at, _ in told], np.int64)
    time_s = np.concatenate([[-np.inf], clock.time_s(at_ns)])
    values = np.array([float(rest_m[0]), *(width_m for _, width_m in told)])[:, None]
    return _sorted(time_s, values, np.concatenate([[0], at_ns]))


STAGES = ("between", "capture", "detect", "plan", "execute", "verify", "deliver", "approve")
"""Activities of the cell, by index: a stage of the cycle, or none. A new one comes last: data sets keep the others."""


def stage_index(stages: Iterable[Stage], clock: EpisodeClock, at_s: Array) -> Array:
    """Return the index (m,) of the stage in `STAGES` that ran at these times."""
    index = np.zeros(len(at_s), np.int64)
    for stage in sorted(stages, key=lambda one: one.started_ns):
        began_s, ended_s = clock.time_s([stage.started_ns, stage.started_ns + round(stage.duration_s * 1e9)])
        index[(at_s >= began_s) & (at_s <= ended_s)] = STAGES.index(stage.stage)
    return index
