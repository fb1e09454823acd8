"""The alignment as a rotatable view: observed and imagined points in ``base``, before and after, rod and hand."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go

from bus.messages import Detections, Grasp
from logs.figures import INK

_SHOWN_POINTS = 2500
"""Of each cloud: a phone turns these smoothly."""
_OBSERVED, _IMAGINED, _ROD, _HAND = "#7b8794", "#2f6fde", "#d6249f", "#1f8a5b"

Array = npt.NDArray[np.float64]


class View(NamedTuple):
    """A figure whose traces belong to the view before the alignment, after it, or both."""

    figure: go.Figure
    before: list[bool]
    after: list[bool]


def clouds(found: Detections, grasp: Grasp | None, base_from_color: Array) -> View:
    """What was lifted, before and after it was carried back onto the observed object; the rod's run and the hand."""
    evidence = found.evidence
    goal_from_observed = np.linalg.inv(np.asarray(evidence.alignment.observed_from_goal))
    rod = evidence.rod_points.astype(float)
    dots = (
        ("observed", evidence.observed_points, _OBSERVED, 1.8, True, True),
        ("imagined, as lifted", evidence.goal_points, _IMAGINED, 1.8, True, False),
        ("its rod", _moved(rod, goal_from_observed), _ROD, 2.2, True, False),
        ("imagined, carried back", evidence.aligned_points, _IMAGINED, 1.8, False, True),
        ("rod, carried back", rod, _ROD, 2.2, False, True),
    )
    figure = go.Figure()
    for name, points, color, size, _, is_after in dots:
        x, y, z = _millimetres(_thin(points.astype(float)), base_from_color)
        marker = {"size": size, "color": color}
        figure.add_scatter3d(x=x, y=y, z=z, mode="markers", name=name, marker=marker, hoverinfo="skip", visible=is_after)
    _add_line(figure, "run through the object", np.array(evidence.rod_ends), base_from_color, _ROD)
    if grasp is not None:
        _add_line(figure, "hand", _hand_outline(grasp), np.eye(4), _HAND)
    lines = len(figure.data) - len(dots)
    axes = {f"{a}axis": {"title": f"{a} [mm]", "backgroundcolor": "#f6f8fa", "gridcolor": "#dbe2e9"} for a in "xyz"}
    figure.update_layout(
        scene={"aspectmode": "data", **axes, "camera": {"eye": {"x": -1.3, "y": -1.3, "z": 0.9}}},
        height=480, paper_bgcolor="rgba(0,0,0,0)", margin={"l": 0, "r": 0, "t": 0, "b": 0},
        font={"color": INK, "size": 12, "family": "system-ui, sans-serif"},
        legend={"orientation": "h", "y": 0, "yanchor": "top", "itemsizing": "constant"},
    )  # fmt: skip
    before, after = [one[4] for one in dots], [one[5] for one in dots]
    return View(figure, before + [False] * lines, after + [True] * lines)


def _add_line(figure: go.Figure, name: str, points: Array, base_from_points: Array, color: str) -> None:
    x, y, z = _millimetres(points, base_from_points)
    line = {"color": color, "width": 8}
    figure.add_scatter3d(x=x, y=y, z=z, mode="lines", name=name, line=line, hoverinfo="skip")


def _thin(points: Array) -> Array:
    return points[:: max(1, -(-len(points) // _SHOWN_POINTS))]


def _moved(points: Array, a_from_b: Array) -> Array:
    return np.asarray(points @ a_from_b[:3, :3].T + a_from_b[:3, 3])


def _millimetres(points: Array, base_from_points: Array) -> npt.NDArray[np.float32]:
    return np.asarray(_moved(points.reshape(-1, 3), base_from_points).T * 1e3, dtype=np.float32)


def _hand_outline(grasp: Grasp) -> Array:
    """Palm and both fingers of the opened hand as one line (n, 3) in ``base``."""
    half, tip, palm = grasp.opening_m / 2, 0.009, -0.045
    corners = [(0, -half, tip), (0, -half, palm), (0, 0, palm), (0, 0, palm - 0.04), (0, 0, palm), (0, half, palm)]
    return _moved(np.array([*corners, (0, half, tip)]), np.asarray(grasp.base_from_tcp))
