"""The alignment as a rotatable 3-D view in ``base``: observed and imagined points, rod and hand. See docs/frames.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.codec import Json
from bus.messages import Detections, Evidence, Grasp
from bus.transforms import apply
from config.franka_hand import FINGER_LENGTH_M, FINGER_TIP_M
from logs.report.figures import FONT
from logs.report.page import Figure

_SHOWN_POINTS = 2500
"""Most points of each cloud: a phone renders these smoothly."""
_FUSED_POINTS = 4500
"""Most points of all looks together."""
_OBSERVED, _IMAGINED, _ROD, _HAND = "#7b8794", "#2f6fde", "#d6249f", "#1f8a5b"
_BLOCKED, _REJECTED_HAND = "#d8273f", "#e08a00"

_SIGHT_M = (0.14, 0.24)
"""Between these distances from the things' middle a line shows from where a look came; the camera is farther off."""

_AXIS = {"backgroundcolor": "#f6f8fa", "gridcolor": "#dbe2e9", "showbackground": True}
_CAMERA = {"eye": {"x": -0.95, "y": -0.95, "z": 0.75}, "center": {"z": -0.12}}
_LAYOUT = {
    "scene": {
        "aspectmode": "data",
        "camera": _CAMERA,
        **{f"{axis}axis": {**_AXIS, "title": {"text": f"{axis} [mm]"}} for axis in "xyz"},
    },
    "height": 420, "paper_bgcolor": "rgba(0,0,0,0)", "margin": {"l": 0, "r": 0, "t": 0, "b": 0}, "font": FONT,
    "legend": {"orientation": "h", "y": 0, "yanchor": "top", "itemsizing": "constant"},
}  # fmt: skip

Array = npt.NDArray[np.float64]


class View(NamedTuple):
    """A figure whose traces belong to the view before the alignment, after it, or both."""

    figure: Figure
    before: list[bool]
    after: list[bool]


def clouds(found: Detections, grasp: Grasp | None, base_from_color: Array, is_painted: bool) -> View:
    """Return the observed and the imagined points before and after alignment, the rod's run, and the hand at ``grasp``.

    Args:
        base_from_color: (4, 4).
        is_painted: the rod was painted into the observed image: there is nothing imagined beside what was observed.
    """
    evidence = found.evidence
    dots = _painted_dots(evidence) if is_painted else _imagined_dots(evidence)
    data = [
        _trace(
            name, _thin(points.astype(float)), base_from_color, mode="markers", marker={"size": size, "color": color}
        )
        for name, points, color, size, _, _ in dots
    ]
    lines = [("run through the object", np.array(evidence.rod_ends), base_from_color, _ROD)]
    if grasp is not None:
        lines.append(("hand", _hand_outline(grasp), np.eye(4), _HAND))
    data += [
        _trace(name, points, base_from_points, mode="lines", line={"color": color, "width": 8})
        for name, points, base_from_points, color in lines
    ]
    before = [one[4] for one in dots] + [False] * len(lines)
    after = [one[5] for one in dots] + [True] * len(lines)
    for trace, visible in zip(data, after, strict=True):
        trace["visible"] = visible
    return View({"data": data, "layout": _LAYOUT}, before, after)


def fused(looks: Sequence[tuple[str, str, Array, Array]], grasp: Grasp | None) -> Figure:
    """Draw what several looks measured of the things, each in its own colour and with its line of sight, and the hand.

    Args:
        looks: name, colour, points (n, 3) and the camera's place (3,), all in ``base`` [m].
    """
    still, data = np.eye(4), list[Json]()
    measured = np.concatenate([points for _, _, points, _ in looks])
    middle = np.median(measured, axis=0) if len(measured) else np.zeros(3)
    for name, color, points, _ in looks:
        few = _thin(points, _FUSED_POINTS // len(looks))
        data.append(_trace(name, few, still, mode="markers", marker={"size": 2.2, "color": color}))
    for name, color, _, place in looks:
        away = (place - middle) / max(float(np.linalg.norm(place - middle)), 1e-9)
        sight = middle + np.outer(_SIGHT_M, away)
        line = {"width": 6, "color": color}
        data.append(_trace(f"sight of {name}", sight, still, mode="lines", line=line, showlegend=False))
    if grasp is not None:
        line = {"width": 8, "color": _HAND}
        data.append(_trace("hand", _hand_outline(grasp), still, mode="lines", line=line))
    return {"data": data, "layout": _LAYOUT}


def among_points(
    seen: Array, obstacle: Array, touch: Array, hand: Mapping[str, Array], blocked: str, *, is_box: bool
) -> Figure:
    """An obstacle among what was seen, with the hand where it would be. All in ``base`` [m].

    Args:
        seen, obstacle: points (n, 3); of a box its eight corners. ``touch``: (3,).
        hand: the corners (8, 3) of its parts by their names. ``blocked``: the part that would touch.
    """
    still = np.eye(4)
    data = [_trace("seen of the things", _thin(seen), still, mode="markers", marker={"size": 1.8, "color": _OBSERVED})]
    if is_box:
        line = {"width": 5, "color": _BLOCKED}
        data.append(_trace("in the way", _edges(obstacle), still, mode="lines", line=line))
    else:
        marker = {"size": 3.2, "color": _BLOCKED}
        data.append(_trace("in the way", _thin(obstacle), still, mode="markers", marker=marker))
    for name, corners in hand.items():
        line = {"width": 8 if name == blocked else 5, "color": _BLOCKED if name == blocked else _REJECTED_HAND}
        data.append(_trace(name, _edges(corners), still, mode="lines", line=line))
    marker = {"size": 7, "color": _BLOCKED, "symbol": "diamond"}
    data.append(_trace("touch", touch[None], still, mode="markers", marker=marker))
    return {"data": data, "layout": _LAYOUT}


def _edges(corners: Array) -> Array:
    """One line (n, 3) along the edges of a box, whose corners (8, 3) are in the order of `itertools.product`."""
    return corners[[0, 1, 3, 2, 0, 4, 5, 7, 6, 4, 5, 1, 3, 7, 6, 2]]


Dots = tuple[tuple[str, npt.NDArray[np.floating], str, float, bool, bool], ...]
"""Name, points (n, 3) in ``color``, colour and size of each cloud; whether it is of before, and of after."""


def _painted_dots(evidence: Evidence) -> Dots:
    return (
        ("observed", evidence.observed_points, _OBSERVED, 1.8, True, True),
        ("rod", evidence.rod_points, _ROD, 2.2, True, True),
    )


def _imagined_dots(evidence: Evidence) -> Dots:
    goal_from_observed = np.linalg.inv(np.asarray(evidence.alignment.observed_from_goal))
    rod = evidence.rod_points.astype(float)
    return (
        ("observed", evidence.observed_points, _OBSERVED, 1.8, True, True),
        ("imagined, as lifted", evidence.goal_points, _IMAGINED, 1.8, True, False),
        ("its rod", apply(goal_from_observed, rod), _ROD, 2.2, True, False),
        ("imagined, carried back", evidence.aligned_points, _IMAGINED, 1.8, False, True),
        ("rod, carried back", rod, _ROD, 2.2, False, True),
    )


def _trace(name: str, points: Array, base_from_points: Array, **style: object) -> Json:
    x, y, z = apply(base_from_points, points.reshape(-1, 3)).T * 1e3
    return {"type": "scatter3d", "name": name, "x": x, "y": y, "z": z, "hoverinfo": "skip", **style}


def _thin(points: Array, most: int = _SHOWN_POINTS) -> Array:
    return points[:: max(1, -(-len(points) // most))]


def _hand_outline(grasp: Grasp) -> Array:
    """Palm and both fingers of the opened hand as one polyline (n, 3) [m] in ``base``."""
    half, tip, palm = grasp.opening_m / 2, FINGER_TIP_M, FINGER_TIP_M - FINGER_LENGTH_M
    corners = [(0, -half, tip), (0, -half, palm), (0, 0, palm), (0, 0, palm - 0.04), (0, 0, palm), (0, half, palm)]
    return apply(np.asarray(grasp.base_from_tcp), np.array([*corners, (0, half, tip)]))
