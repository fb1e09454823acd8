"""The pictures of a report page: images as data URIs, curves and clouds as plotly figures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go

from bus.messages import Detections, Grasp, Rectangle, SegmentRun
from bus.trajectory import TICK_S
from config.limits import ACCELERATION_RAD_S2, JERK_RAD_S3, LOWER_RAD, UPPER_RAD, velocity_bounds

_RECTANGLE_RGB, _OUTLINE_RGB = (255, 214, 10), (10, 200, 120)
_BUCKETS = 400
_COLORS = ("#2f6fde", "#e0632d", "#2c9c69", "#a855c7", "#c2922a", "#c43d5c", "#5d6b7a")

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]


def data_uri(image: npt.NDArray[Any], *, width_px: int = 960) -> str:
    """An RGB image or mask as a JPEG or PNG data URI, at most ``width_px`` wide."""
    pixels = image.astype(np.uint8) * 255 if image.dtype == np.bool_ else np.asarray(image[..., ::-1])
    if pixels.shape[1] > width_px:
        height_px = round(pixels.shape[0] * width_px / pixels.shape[1])
        pixels = cv2.resize(pixels, (width_px, height_px), interpolation=cv2.INTER_AREA)
    kind = "png" if image.dtype == np.bool_ else "jpeg"
    _, encoded = cv2.imencode(f".{kind}", pixels)
    return f"data:image/{kind};base64,{base64.b64encode(encoded.tobytes()).decode()}"


def file_uri(image: bytes | None) -> str:
    """A picture's file, as it came, as a data URI; "" for none. Torn ones stay torn."""
    if image is None:
        return ""
    kind = "jpeg" if image.startswith(b"\xff\xd8") else "png"
    return f"data:image/{kind};base64,{base64.b64encode(image).decode()}"


def annotated(found: Detections) -> Image:
    """The colour image with the object's outline and the grasp rectangles, the chosen run's thick."""
    image = np.array(found.evidence.color)
    contours, _ = cv2.findContours(
        found.evidence.object_mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(image, contours, -1, _OUTLINE_RGB, 2, cv2.LINE_AA)
    best = found.grasps[0].rectangle if found.grasps else 0
    for index, rectangle in enumerate(found.rectangles):
        cv2.polylines(image, [_corners(rectangle)], True, _RECTANGLE_RGB, 4 if index == best else 1, cv2.LINE_AA)
    return image


def _corners(rectangle: Rectangle) -> npt.NDArray[np.int32]:
    size = (rectangle.width_px, rectangle.height_px)
    corners = cv2.boxPoints((rectangle.center_px, size, np.degrees(rectangle.angle_rad)))
    return np.asarray(np.rint(corners), dtype=np.int32)


def crop(image: npt.NDArray[Any], mask: npt.NDArray[np.bool_], margin_px: int = 90) -> npt.NDArray[Any]:
    """The part of ``image`` around ``mask``, for a closer look; the whole image for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return image
    top, left = max(0, rows[0] - margin_px), max(0, columns[0] - margin_px)
    return image[top : rows[-1] + margin_px, left : columns[-1] + margin_px]


def clouds(found: Detections, grasp: Grasp | None, base_from_color: Array) -> go.Figure:
    """Observed, imagined and carried-back points in ``base``, the rod's run, and the hand that takes it. Rotatable."""
    evidence = found.evidence
    figure = go.Figure()
    for name, points, color, size in (
        ("observed", evidence.observed_points, "#7f8c99", 1.6),
        ("imagined", evidence.goal_points, "#e0a12d", 1.4),
        ("carried back", evidence.aligned_points, "#2f6fde", 1.4),
        ("rod", evidence.rod_points, "#d6249f", 2.0),
    ):
        x, y, z = _millimetres(points.astype(float), base_from_color)
        marker = {"size": size, "color": color}
        figure.add_scatter3d(x=x, y=y, z=z, mode="markers", name=name, marker=marker, hoverinfo="skip")
    x, y, z = _millimetres(np.array(evidence.rod_ends), base_from_color)
    line = {"color": "#d6249f", "width": 8}
    figure.add_scatter3d(x=x, y=y, z=z, mode="lines", name="run through the object", line=line)
    if grasp is not None:
        x, y, z = _millimetres(_hand_outline(grasp), np.eye(4))
        figure.add_scatter3d(x=x, y=y, z=z, mode="lines", name="hand", line={"color": "#2c9c69", "width": 6})
    axes = {f"{axis}axis": {"title": f"{axis} [mm]"} for axis in "xyz"}
    figure.update_layout(scene={"aspectmode": "data", **axes}, height=520)
    return _plain(figure)


def _millimetres(points: Array, base_from_points: Array) -> Array:
    return np.asarray((points @ base_from_points[:3, :3].T + base_from_points[:3, 3]).T * 1e3)


def _hand_outline(grasp: Grasp) -> Array:
    """Palm and both fingers of the opened hand as one line (n, 3) in ``base``."""
    half, tip, palm = grasp.opening_m / 2, 0.009, -0.045
    corners = [(0, -half, tip), (0, -half, palm), (0, 0, palm), (0, 0, palm - 0.04), (0, 0, palm), (0, half, palm)]
    outline = np.array([*corners, (0, half, tip)])
    return np.asarray(outline @ grasp.base_from_tcp[:3, :3].T + grasp.base_from_tcp[:3, 3])


def joint_use(runs: Sequence[SegmentRun]) -> dict[str, go.Figure]:
    """Commanded position, velocity, acceleration and jerk of every joint as a share of its limit, over the cycle."""
    shares = [_shares(run.motion.commanded_q_rad) for run in runs]
    starts_s = np.cumsum([0.0, *(len(run.motion.commanded_q_rad) * TICK_S for run in runs)])
    figures = {}
    for name in ("position", "velocity", "acceleration", "jerk"):
        figure = go.Figure()
        time_s = np.concatenate(
            [start + np.arange(len(share[name])) * TICK_S for start, share in zip(starts_s[:-1], shares, strict=True)]
        )
        values = np.concatenate([share[name] for share in shares])
        for joint in range(7):
            t, y = _extremes(time_s, values[:, joint])
            figure.add_scatter(x=t, y=y, name=f"joint {joint + 1}", line={"width": 1.3, "color": _COLORS[joint]})
        for limit in (-1, 1):
            figure.add_hline(y=limit, line={"color": "#c43d5c", "dash": "dash", "width": 1.5})
        _mark_segments(figure, runs, starts_s)
        figure.update_layout(yaxis={"title": f"{name} / limit", "range": [-1.15, 1.15]}, xaxis={"title": "motion [s]"})
        figures[name] = _plain(figure)
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


def _extremes(t: Array, y: Array) -> tuple[Array, Array]:
    """At most two points a bucket: its smallest and its largest value, so that no peak is lost."""
    if len(y) <= 2 * _BUCKETS:
        return t, y
    chosen = []
    for part in np.array_split(np.arange(len(y)), _BUCKETS):
        chosen += sorted({int(part[y[part].argmin()]), int(part[y[part].argmax()])})
    return t[chosen], np.round(y[chosen], 4)


def _mark_segments(figure: go.Figure, runs: Sequence[SegmentRun], starts_s: Array) -> None:
    last = ""
    for run, start_s in zip(runs, starts_s[:-1], strict=True):
        if run.name != last:
            figure.add_vline(x=float(start_s), line={"color": "#8896a5", "width": 1, "dash": "dot"})
            figure.add_annotation(
                x=float(start_s), y=1.08, text=run.name, showarrow=False, xanchor="left", textangle=-35
            )
        last = run.name


def hand_width(runs: Sequence[SegmentRun], grasped_width_m: float | None) -> go.Figure:
    """The hand's width after every motion of the cycle."""
    figure = go.Figure()
    end_s = np.cumsum([run.motion.t_s[-1] for run in runs])
    width_mm = [run.hand.width_m * 1e3 for run in runs]
    names = [run.name for run in runs]
    line = {"shape": "vh", "color": _COLORS[0]}
    figure.add_scatter(x=end_s, y=width_mm, text=names, mode="lines+markers", name="width", line=line)
    if grasped_width_m is not None:
        figure.add_hline(
            y=grasped_width_m * 1e3, annotation_text="closed on", line={"dash": "dot", "color": _COLORS[2]}
        )
    figure.update_layout(yaxis={"title": "hand width [mm]", "rangemode": "tozero"}, xaxis={"title": "motion [s]"})
    return _plain(figure)


def tracking(runs: Sequence[SegmentRun]) -> go.Figure:
    """Measured minus commanded position of every joint [mrad]."""
    figure = go.Figure()
    start_s, times, errors = 0.0, [], []
    for run in runs:
        motion = run.motion
        tick = np.minimum(np.rint(motion.t_s / TICK_S).astype(int), len(motion.commanded_q_rad)) - 1
        times.append(start_s + motion.t_s)
        errors.append((motion.q_rad - motion.commanded_q_rad[np.maximum(tick, 0)]) * 1e3)
        start_s += float(motion.t_s[-1])
    time_s, error_mrad = np.concatenate(times), np.concatenate(errors)
    for joint in range(7):
        t, y = _extremes(time_s, error_mrad[:, joint])
        figure.add_scatter(x=t, y=y, name=f"joint {joint + 1}", line={"width": 1.2, "color": _COLORS[joint]})
    figure.update_layout(yaxis={"title": "measured - commanded [mrad]"}, xaxis={"title": "motion [s]"})
    return _plain(figure)


def _plain(figure: go.Figure) -> go.Figure:
    """No background of its own, so that it fits a light page and a dark one."""
    return figure.update_layout(
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(128,140,155,0.08)",
        font={"color": "#8593a3", "size": 12},
        margin={"l": 60, "r": 10, "t": 50, "b": 45},
        legend={"orientation": "h", "y": -0.22, "itemsizing": "constant"},
    )
