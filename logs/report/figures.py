"""The charts of a report page as plotly.js figures: motion against its limits, the hand, the load."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from bus.codec import Json
from bus.messages import HandState, SegmentRun
from bus.trajectory import TICK_S
from config.limits import JointLimits, Peak
from logs.mcap.reader import Timed
from logs.report.page import Figure

KINDS = ("position", "velocity", "acceleration", "jerk")
JOINT_COLORS = ("#2f6fde", "#e0632d", "#2c9c69", "#a855c7", "#c2922a", "#c43d5c", "#5d6b7a")
GRID, BAD, GOOD = "#e6ebf0", "#c43d5c", "#1f8a5b"
_BUCKETS = 300
_NEAR_PERCENT = 40.0
"""Curves that stay below this [%] are enlarged, and the limit is out of range."""
_LABELLED = 0.08
"""A segment shorter than this share of the motion gets no label."""

FONT = {"color": "#3c4856", "size": 12, "family": "system-ui, sans-serif"}

Array = npt.NDArray[np.float64]


class Use(NamedTuple):
    """The sample of a cycle's motions that comes closest to one kind of limit, and its segment."""

    kind: str
    peak: Peak
    segment: str

    @property
    def in_words(self) -> str:
        """One phrase: the share of the limit, the joint and the segment."""
        return f"{self.peak.ratio:.0%} (joint {self.peak.joint}, {self.segment})"


def uses(limits: JointLimits, runs: Sequence[SegmentRun]) -> list[Use]:
    """For each kind of limit the sample with the highest use over all ``runs``; empty without motion."""
    reports = [(run.name, limits.check(run.motion.commanded_q_rad)) for run in runs if len(run.motion.commanded_q_rad)]
    if not reports:
        return []
    best = {kind: max(reports, key=lambda one: getattr(one[1], kind).ratio) for kind in KINDS}
    return [Use(kind, getattr(report, kind), name) for kind, (name, report) in best.items()]


def joint_use(limits: JointLimits, runs: Sequence[SegmentRun]) -> dict[str, Figure]:
    """Commanded position, velocity, acceleration and jerk of every joint as a share of its limit, over the motion."""
    shares = [limits.shares(run.motion.commanded_q_rad).of_samples() for run in runs]
    starts_s = _starts_s(runs)
    time_s = np.concatenate([t + np.arange(len(s.jerk)) * TICK_S for t, s in zip(starts_s, shares, strict=True)])
    figures = {}
    for kind in KINDS:
        values = np.concatenate([getattr(share, kind) for share in shares]) * 100
        largest = float(np.abs(values).max(initial=1.0))
        most = 125.0 if largest > _NEAR_PERCENT else 1.3 * largest
        figure = _plain(_joints(time_s, values), "motion [s]", "of the limit [%]")
        figure["layout"]["yaxis"]["range"] = [-most, most]
        for limit in (-100, 100):
            _add_level(figure, limit, "", BAD)
        _name_segments(figure, runs)
        figures[kind] = figure
    return figures


def tracking(runs: Sequence[SegmentRun]) -> Figure:
    """Measured minus commanded position of every joint [mrad]."""
    errors = []
    for run in runs:
        motion = run.motion
        tick = np.minimum(np.rint(motion.t_s / TICK_S).astype(int), len(motion.commanded_q_rad)) - 1
        errors.append((motion.q_rad - motion.commanded_q_rad[np.maximum(tick, 0)]) * 1e3)
    return _measured(runs, np.concatenate(errors), "measured - commanded [mrad]")


def load(runs: Sequence[SegmentRun]) -> Figure:
    """External torque on every joint [Nm]: the load in the hand, and contacts of the arm."""
    return _measured(runs, np.concatenate([run.motion.tau_ext_nm for run in runs]), "torque from outside [Nm]")


def as_said(limits: JointLimits, arm: Sequence[Timed[JointStates]], start_ns: int) -> dict[str, Figure]:
    """Return the arm's published positions and torques over the cycle, for a cycle whose motions have no result.

    Args:
        limits: of the arm's joints. ``start_ns``: start of the cycle, UTC.
    """
    whole = [one for one in arm if len(one.message.joints) == limits.joints]
    time_s = np.array([(one.log_time_ns - start_ns) / 1e9 for one in whole])
    q_rad, effort_nm = (
        np.array([[getattr(joint, name) for joint in one.message.joints] for one in whole]).reshape(-1, limits.joints)
        for name in ("position", "effort")
    )
    return {
        "Measured positions": _plain(
            _joints(time_s, 100 * limits.position_share(q_rad)), "cycle [s]", "of the limit [%]"
        ),
        "Load: torque from outside": _plain(_joints(time_s, effort_nm), "cycle [s]", "torque from outside [Nm]"),
    }


def _measured(runs: Sequence[SegmentRun], values: Array, title: str) -> Figure:
    time_s = np.concatenate([start + run.motion.t_s for start, run in zip(_starts_s(runs), runs, strict=True)])
    figure = _plain(_joints(time_s, values), "motion [s]", title)
    _name_segments(figure, runs)
    return figure


def hand_width(
    said: Sequence[Timed[HandState]], start_ns: int, grasped_mm: float | None, least_mm: float | None
) -> Figure:
    """Return the hand's width over the cycle [mm], the width at the grasp, and the least width of a held object.

    Args:
        start_ns: start of the cycle, UTC. ``grasped_mm``, ``least_mm``: None = not drawn.
    """
    time_s = np.array([(one.log_time_ns - start_ns) / 1e9 for one in said])
    width_mm = np.array([one.message.width_m * 1e3 for one in said])
    figure = _plain([_curve(time_s, width_mm, "width", JOINT_COLORS[0])], "cycle [s]", "hand width [mm]")
    figure["layout"]["yaxis"]["rangemode"] = "tozero"
    for value_mm, text, color in ((grasped_mm, "closed on", GOOD), (least_mm, "counts as empty below", BAD)):
        if value_mm is not None:
            _add_level(figure, value_mm, f"{text} {value_mm:.1f} mm", color)
    return figure


def _joints(time_s: Array, values: Array) -> list[Json]:
    """One curve per joint of ``values`` (m, n)."""
    colors = enumerate(JOINT_COLORS[: values.shape[1]])
    return [_curve(time_s, values[:, joint], f"joint {joint + 1}", color) for joint, color in colors]


def _curve(time_s: Array, values: Array, name: str, color: str) -> Json:
    line = {"width": 1.3, "color": color}
    return {"type": "scatter", "mode": "lines", "name": name, "line": line, **_points(time_s, values)}


def _add_level(figure: Figure, y: float, text: str, color: str) -> None:
    line = {"color": color, "dash": "dash", "width": 1.5}
    layout = figure["layout"]
    layout["shapes"].append({"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line})
    side = {"x": 0, "xanchor": "left"} if color == GOOD else {"x": 1, "xanchor": "right"}
    label = {"xref": "paper", **side, "y": y, "yanchor": "bottom", "showarrow": False}
    layout["annotations"].append({**label, "text": text, "font": {"color": color}})


def _starts_s(runs: Sequence[SegmentRun]) -> Array:
    """Start of each run [s], as if the runs followed each other without a pause."""
    return np.cumsum([0.0, *(_length_s(run) for run in runs[:-1])])


def _length_s(run: SegmentRun) -> float:
    commanded_s = len(run.motion.commanded_q_rad) * TICK_S
    return max(commanded_s, float(run.motion.t_s[-1])) if len(run.motion.t_s) else commanded_s


def _name_segments(figure: Figure, runs: Sequence[SegmentRun]) -> None:
    """Draw a line at the start of each segment, with its name; consecutive runs of one name are one."""
    starts_s, total_s = _starts_s(runs), sum(_length_s(run) for run in runs)
    begins = [
        (run.name, t)
        for i, (run, t) in enumerate(zip(runs, starts_s, strict=True))
        if i == 0 or runs[i - 1].name != run.name
    ]
    for (name, begin_s), (_, end_s) in zip(begins, [*begins[1:], ("", total_s)], strict=True):
        if begin_s:
            line = {"color": "#aab4bf", "width": 1, "dash": "dot"}
            border = {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": float(begin_s), "x1": float(begin_s)}
            figure["layout"]["shapes"].append({**border, "line": line})
        if end_s - begin_s > _LABELLED * total_s:
            middle = {"x": float(begin_s + end_s) / 2, "y": 1, "yref": "paper", "yanchor": "bottom"}
            figure["layout"]["annotations"].append({**middle, "text": name, "showarrow": False, "font": {"size": 10}})


def _points(t: Array, y: Array) -> Json:
    """All points; of many the minimum and the maximum of each bucket, in their order, so that no peak is lost.

    Those are drawn at even distances, at most a bucket away from where they were: their times need no room.
    """
    if len(y) <= 2 * _BUCKETS:
        return {"x": t, "y": y}
    ends = np.array_split(np.arange(len(y)), _BUCKETS)
    chosen = [sorted((int(part[y[part].argmin()]), int(part[y[part].argmax()]))) for part in ends]
    step = float(t[-1] - t[0]) / (2 * _BUCKETS)
    return {"x0": float(t[0]) + step / 2, "dx": step, "y": y[np.ravel(chosen)]}


def _plain(data: list[Json], x_title: str, y_title: str) -> Figure:
    layout = {
        "xaxis": {"title": {"text": x_title}, "gridcolor": GRID, "zeroline": False},
        "yaxis": {"title": {"text": y_title}, "gridcolor": GRID, "zerolinecolor": "#c3ccd6"},
        "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "#ffffff", "hovermode": "closest", "dragmode": False,
        "font": FONT, "margin": {"l": 56, "r": 8, "t": 22, "b": 42}, "height": 270, "showlegend": False,
        "shapes": [], "annotations": [],
    }  # fmt: skip
    return {"data": data, "layout": layout}
