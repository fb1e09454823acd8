"""The curves of a report page, as plotly figures over the motion's time: against the limits, the hand, the load."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go

from bus.messages import SegmentRun
from bus.trajectory import TICK_S
from config.limits import ACCELERATION_RAD_S2, JERK_RAD_S3, LOWER_RAD, UPPER_RAD, Peak, check, velocity_bounds
from logs.reader import Timed

KINDS = ("position", "velocity", "acceleration", "jerk")
JOINT_COLORS = ("#2f6fde", "#e0632d", "#2c9c69", "#a855c7", "#c2922a", "#c43d5c", "#5d6b7a")
INK, GRID, BAD, GOOD = "#3c4856", "#e6ebf0", "#c43d5c", "#1f8a5b"
_BUCKETS = 300
_LABELLED = 0.06
"""A segment shorter than this share of the motion has no room for its name."""

Array = npt.NDArray[np.float64]


class Use(NamedTuple):
    """The sample of a cycle's motions that comes nearest to one kind of limit, and where that was."""

    kind: str
    peak: Peak
    segment: str

    @property
    def in_words(self) -> str:
        return f"{self.peak.ratio:.0%} (joint {self.peak.joint}, {self.segment})"


def uses(runs: Sequence[SegmentRun]) -> list[Use]:
    """For each kind of limit its most used sample over all ``runs``; empty when nothing moved."""
    reports = [(run.name, check(run.motion.commanded_q_rad)) for run in runs if len(run.motion.commanded_q_rad)]
    if not reports:
        return []
    best = {kind: max(reports, key=lambda one: getattr(one[1], kind).ratio) for kind in KINDS}
    return [Use(kind, getattr(report, kind), name) for kind, (name, report) in best.items()]


def joint_use(runs: Sequence[SegmentRun]) -> dict[str, go.Figure]:
    """Commanded position, velocity, acceleration and jerk of every joint as a share of its limit, over the motion."""
    moved = [run for run in runs if len(run.motion.commanded_q_rad)]
    shares = [_shares(run.motion.commanded_q_rad) for run in moved]
    time_s = np.concatenate([start + np.arange(len(s["jerk"])) * TICK_S for start, s in zip(_starts_s(moved), shares)])
    figures = {}
    for kind in KINDS:
        values = np.concatenate([share[kind] for share in shares]) * 100
        figure = _joints(time_s, values)
        for limit in (-100, 100):
            figure.add_hline(y=limit, line={"color": BAD, "dash": "dash", "width": 1.5})
        _name_segments(figure, moved)
        figure.update_layout(yaxis={"title": "of the limit [%]", "range": [-125, 125], "tickvals": [-100, -50, 0, 50, 100]})
        figures[kind] = _plain(figure, "motion [s]")
    return figures


def _shares(q_rad: Array) -> dict[str, Array]:
    """Each derivative over its limit, at 1 kHz, at rest before and after (libfranka's differences)."""
    rest = np.pad(q_rad, ((3, 3), (0, 0)), mode="edge")
    velocity = np.diff(rest, axis=0) / TICK_S
    lower, upper = velocity_bounds(rest[1:])
    middle, half = (UPPER_RAD + LOWER_RAD) / 2, (UPPER_RAD - LOWER_RAD) / 2
    n = len(q_rad)
    return {
        "position": (q_rad - middle) / half,
        "velocity": (velocity / np.where(velocity >= 0, upper, -lower))[2 : n + 2],
        "acceleration": (np.diff(velocity, axis=0) / TICK_S / ACCELERATION_RAD_S2)[1 : n + 1],
        "jerk": (np.diff(velocity, n=2, axis=0) / TICK_S**2 / JERK_RAD_S3)[:n],
    }


def tracking(runs: Sequence[SegmentRun]) -> go.Figure:
    """Measured minus commanded position of every joint [mrad]."""
    errors = []
    for run in runs:
        motion = run.motion
        tick = np.minimum(np.rint(motion.t_s / TICK_S).astype(int), len(motion.commanded_q_rad)) - 1
        errors.append((motion.q_rad - motion.commanded_q_rad[np.maximum(tick, 0)]) * 1e3)
    return _measured(runs, np.concatenate(errors), "measured - commanded [mrad]")


def load(runs: Sequence[SegmentRun]) -> go.Figure:
    """The torque that the outside world put on every joint [Nm]: what the hand carried, what the arm touched."""
    return _measured(runs, np.concatenate([run.motion.tau_ext_nm for run in runs]), "torque from outside [Nm]")


def _measured(runs: Sequence[SegmentRun], values: Array, title: str) -> go.Figure:
    time_s = np.concatenate([start + run.motion.t_s for start, run in zip(_starts_s(runs), runs, strict=True)])
    figure = _joints(time_s, values)
    _name_segments(figure, runs)
    figure.update_layout(yaxis={"title": title})
    return _plain(figure, "motion [s]")


def hand_width(said: Sequence[Timed], start_ns: int, grasped_mm: float | None, least_mm: float | None) -> go.Figure:
    """The hand's width over the cycle [mm], as it was said; where it closed, and what a held object is at least."""
    figure = go.Figure()
    t = np.array([(one.log_time_ns - start_ns) / 1e9 for one in said])
    width_mm = np.array([one.message.width_m * 1e3 for one in said])
    t, width_mm = _extremes(t, width_mm)
    figure.add_scatter(x=_short(t), y=_short(width_mm), mode="lines", name="width", line={"color": JOINT_COLORS[0]})
    for value_mm, text, color in ((grasped_mm, "closed on", GOOD), (least_mm, "holds nothing below", BAD)):
        if value_mm is not None:
            text = f"{text} {value_mm:.1f} mm"
            line = {"dash": "dash", "width": 1.5, "color": color}
            figure.add_hline(y=value_mm, line=line, annotation_text=text, annotation_font_color=color)
    figure.update_layout(yaxis={"title": "hand width [mm]", "rangemode": "tozero"}, showlegend=False)
    return _plain(figure, "cycle [s]")


def _joints(time_s: Array, values: Array) -> go.Figure:
    """One curve a joint of ``values`` (n, 7)."""
    figure = go.Figure()
    for joint in range(7):
        t, y = _extremes(time_s, values[:, joint])
        line = {"width": 1.3, "color": JOINT_COLORS[joint]}
        figure.add_scatter(x=_short(t), y=_short(y), name=f"joint {joint + 1}", mode="lines", line=line)
    return figure.update_layout(showlegend=False)


def _starts_s(runs: Sequence[SegmentRun]) -> Array:
    """When each run began, if one followed the other without a pause [s]."""
    return np.cumsum([0.0, *(_length_s(run) for run in runs[:-1])])


def _length_s(run: SegmentRun) -> float:
    commanded_s = len(run.motion.commanded_q_rad) * TICK_S
    return max(commanded_s, float(run.motion.t_s[-1])) if len(run.motion.t_s) else commanded_s


def _name_segments(figure: go.Figure, runs: Sequence[SegmentRun]) -> None:
    """A line where a segment begins, its name above it; runs of one name are one."""
    starts_s, total_s = _starts_s(runs), sum(_length_s(run) for run in runs)
    begins = [(run.name, t) for i, (run, t) in enumerate(zip(runs, starts_s)) if i == 0 or runs[i - 1].name != run.name]
    for (name, begin_s), (_, end_s) in zip(begins, [*begins[1:], ("", total_s)], strict=True):
        if begin_s:
            figure.add_vline(x=float(begin_s), line={"color": "#aab4bf", "width": 1, "dash": "dot"})
        if end_s - begin_s > _LABELLED * total_s:
            figure.add_annotation(
                x=(begin_s + end_s) / 2, y=1, yref="paper", yanchor="bottom", text=name, showarrow=False
            )


def _extremes(t: Array, y: Array) -> tuple[Array, Array]:
    """At most two points a bucket: its smallest and its largest value, so that no peak is lost."""
    if len(y) <= 2 * _BUCKETS:
        return t, y
    chosen = []
    for part in np.array_split(np.arange(len(y)), _BUCKETS):
        chosen += sorted({int(part[y[part].argmin()]), int(part[y[part].argmax()])})
    return t[chosen], y[chosen]


def _short(values: Array) -> npt.NDArray[np.float32]:
    """What a screen can show, in half the bytes."""
    return np.asarray(values, dtype=np.float32)


def _plain(figure: go.Figure, x_title: str) -> go.Figure:
    figure.update_layout(
        xaxis={"title": x_title, "gridcolor": GRID, "zeroline": False},
        yaxis={"gridcolor": GRID, "zerolinecolor": "#c3ccd6"},
        paper_bgcolor="rgba(0,0,0,0)", plot_bgcolor="#ffffff", hovermode="closest", dragmode=False,
        font={"color": INK, "size": 12, "family": "system-ui, sans-serif"},
        margin={"l": 56, "r": 8, "t": 22, "b": 42},
        height=270,
    )  # fmt: skip
    return figure
