"""The HTML pages of `cell compare`: two cycles beside each other, or two folders."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.codec import Json
from bus.messages import Detections
from bus.trajectory import TICK_S
from logs.comparison.cycles import KINDS, Comparison, Row
from logs.comparison.folders import Sides
from logs.comparison.motion import named_runs, torque_nm
from logs.mcap.names import telling
from logs.mcap.reader import CycleRecord
from logs.report import evidence
from logs.report.figures import FONT, GRID
from logs.report.page import Chart, Figure, script_json, write_page
from logs.report.scene import scene_view
from logs.report.timeline import Timeline, summarize

_A, _B, _BETWEEN = "#2f6fde", "#e0632d", "#5d6b7a"
_GAP_S = 0.05
"""Between two segments, so that the curves of both start each of them together."""

Array = npt.NDArray[np.float64]


class Side(NamedTuple):
    """One of the two cycles on the page: its name there, a picture as a data URI, "" for none."""

    name: str
    cycle_id: str
    timeline: Timeline
    picture: str


def write_cycles_page(found: Comparison, path: Path) -> Path:
    """Write the page of two cycles to ``path`` and return it. Raises: RecordingError when it cannot be written."""
    charts = _charts(found.a, found.b)
    content = {
        "sides": [_side("A", found.a), _side("B", found.b)],
        "first": found.first,
        "counts": [(kind, found.count(kind)) for kind in KINDS],
        "stages": [(stage, list(rows)) for stage, rows in groupby(found.rows, key=_stage)],
        "motion": found.motion,
        "charts": charts,
        "figures": script_json({f"chart-{index}": chart.figure for index, chart in enumerate(charts)}),
    }
    return write_page("compare.html.j2", content, path, library=bool(charts))


def write_folders_page(found: Sides, names: tuple[str, str], path: Path) -> Path:
    """Write the page of two folders to ``path`` and return it. Raises: RecordingError when it cannot be written."""
    tables = [("All picks", [found.success, found.held]), ("How often picks ended so", found.codes),
              ("Success by object", found.objects)]  # fmt: skip
    return write_page("compare_folders.html.j2", {"found": found, "names": names, "tables": tables}, path)


def _stage(row: Row) -> str:
    return row.stage


def _side(name: str, record: CycleRecord) -> Side:
    with telling(f"The cycle {record.cycle_id!r}"):
        detect = record.stages.get("detect")
        found = detect.result if detect is not None and isinstance(detect.result, Detections) else None
        picture = evidence.thumbnail(record, found, evidence.choice(record, found), scene_view(record, found))
        return Side(name, record.cycle_id, summarize(record), picture)


# --- charts -----------------------------------------------------------------------------------------------------------


def _charts(a: CycleRecord, b: CycleRecord) -> list[Chart]:
    """Load, hand and the distance of the joints over the motion; each segment starts at the same place in both."""
    in_a, in_b = named_runs(a), named_runs(b)
    if not in_a and not in_b:
        return []
    load: dict[str, list[Array]] = {"A": [], "B": []}
    apart, starts, at_s = [], [], 0.0
    for key in dict.fromkeys([*in_a, *in_b]):
        one, other = in_a.get(key), in_b.get(key)
        starts.append((at_s, key[0]))
        for name, run in (("A", one), ("B", other)):
            if run is not None:
                load[name].append(_ended(at_s + run.motion.t_s, torque_nm(run)))
        commanded = [run.motion.commanded_q_rad for run in (one, other) if run is not None]
        if len(commanded) == 2:
            common = min(map(len, commanded))
            away_rad = np.abs(np.subtract(commanded[0][:common:10], commanded[1][:common:10], dtype=float)).max(axis=1)
            at_each_s = np.array([at_s + tick * TICK_S for tick in range(0, common, 10)])
            apart.append(_ended(at_each_s, away_rad))
        at_s += max(len(q_rad) for q_rad in commanded) * TICK_S + _GAP_S
    curves = [_curve(load["A"], "A", _A), _curve(load["B"], "B", _B)]
    charts = [Chart("Largest torque from outside on a joint", _figure(curves, starts, "torque from outside [Nm]"))]
    if apart:
        parted = _figure([_curve(apart, "A to B", _BETWEEN)], starts, "commanded joints apart [rad]")
        charts.append(Chart("How far the commanded joints are apart", parted))
    return charts


def _ended(time_s: Array, values: Array) -> Array:
    """Times and values (2, n + 1), with a gap at the end."""
    return np.array([[*time_s, time_s[-1]], [*values, np.nan]])


def _curve(parts: list[Array], name: str, color: str) -> Json:
    points = np.concatenate(parts, axis=1) if parts else np.empty((2, 0))
    values = [None if np.isnan(value) else round(float(value), 4) for value in points[1]]
    times = [round(float(value), 3) for value in points[0]]
    return {"type": "scatter", "mode": "lines", "name": name, "x": times, "y": values,
            "line": {"width": 1.4, "color": color}}  # fmt: skip


def _figure(curves: list[Json], starts: list[tuple[float, str]], y_title: str) -> Figure:
    names = [start for index, start in enumerate(starts) if not index or starts[index - 1][1] != start[1]]
    labels = [{"x": at_s, "y": 1, "yref": "paper", "yanchor": "bottom", "xanchor": "left", "text": name,
               "showarrow": False, "font": {"size": 10}} for at_s, name in names]  # fmt: skip
    borders = [{"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": at_s, "x1": at_s,
                "line": {"color": "#aab4bf", "width": 1, "dash": "dot"}} for at_s, _ in names[1:]]  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "motion, segments aligned [s]"}, "gridcolor": GRID, "zeroline": False},
        "yaxis": {"title": {"text": y_title}, "gridcolor": GRID, "rangemode": "tozero"},
        "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "#ffffff", "hovermode": "x", "dragmode": False, "font": FONT,
        "margin": {"l": 56, "r": 8, "t": 22, "b": 42}, "height": 280, "showlegend": len(curves) > 1,
        "legend": {"orientation": "h", "x": 1, "xanchor": "right", "y": 0.98}, "shapes": borders, "annotations": labels,
    }  # fmt: skip
    return {"data": curves, "layout": layout}
