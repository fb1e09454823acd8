"""Stage 3 of the paper: the rod's line, its runs through the object, and the grasp rectangles.

The paper's terms, made exact: a *discontinuity* is a gap between two pieces of rod at least half of which lies on the
object. Several gaps each count, and so does the outer pair. Without a gap, the object's chord under the rod counts.
Pixels are of the undistorted colour image, points are in the ``color`` frame; see docs/frames.md.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import CameraModel, Rectangle
from config.schema import Station
from perception.geometry.lift import lift_pixels, project

_MIN_GAP_PX = 3.0
_LEAST_ROD_PX = 10
_MIN_ISLAND = 0.5
"""Pieces of rod shorter than this many rod widths are noise."""

_MAX_ASTRAY = 0.2
_MAX_SPREAD = 2.0
"""Limits of one straight rod: `_MAX_ASTRAY`, the share of pixels off the line, and fitted width over thickness."""

Mask = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Line:
    """A line in the image: pixels ``center_px + s * direction``.

    Attributes:
        center_px: (2,) = (u, v). ``direction``: (2,) unit vector.
        width_px: width of the rod.
    """

    center_px: Array
    direction: Array
    width_px: float

    def at(self, s: Array) -> Array:
        """Pixels (..., 2) at the distances ``s`` (...) [px] along the line."""
        return np.asarray(self.center_px + np.multiply.outer(s, self.direction))


def fit_line(rod: Mask) -> Line:
    """Return the principal axis of the rod's pixels (H, W), fitted a second time without the outliers of the first fit.

    Raises: CycleFailure(MODEL_NO_ROD) when many pixels are off the line: a bent rod, or several; or without a rod.
    """
    if np.count_nonzero(rod) < _LEAST_ROD_PX:
        raise CycleFailure(Code.MODEL_NO_ROD, "There is no rod in the goal image.")
    v, u = np.nonzero(rod)
    pixels = everything = np.stack([u, v], axis=1).astype(float)
    for _ in range(2):
        center = pixels.mean(axis=0)
        values, axes = np.linalg.eigh(np.cov((pixels - center).T))
        direction = axes[:, 1] * (1.0 if axes[np.abs(axes[:, 1]).argmax(), 1] > 0 else -1.0)
        off = np.abs((pixels - center) @ np.array([-direction[1], direction[0]]))
        width = float(np.sqrt(12 * max(values[0], 1e-9)))
        pixels = pixels[off <= max(width, 1.0)]
    off = np.abs((everything - center) @ np.array([-direction[1], direction[0]]))
    thickness_px = 2 * float(np.percentile(cv2.distanceTransform(rod.astype(np.uint8), cv2.DIST_L2, 3)[rod], 95))
    if (off > max(width, 2.0)).mean() > _MAX_ASTRAY or width > _MAX_SPREAD * thickness_px + 2:
        raise CycleFailure(
            Code.MODEL_NO_ROD,
            f"What is drawn is not one straight rod: {width:.0f} px wide, {thickness_px:.0f} px thick.",
        )
    return Line(center, direction, width)


def runs(line: Line, rod: Mask, on_object: Mask) -> list[tuple[float, float]]:
    """Return the rod's runs through the object: (start, end) along the line [px], the widest first.

    Args:
        rod, on_object: (H, W) masks of the rod and of the object.
    """
    reach = int(np.ceil(np.hypot(*rod.shape)))
    s = np.arange(-reach, reach + 1, dtype=float)
    painted, covered = _along(line, s, rod), _along(line, s, on_object)
    islands = [(a, b) for a, b in _stretches(painted) if b - a + 1 >= _MIN_ISLAND * line.width_px]
    gaps = [
        (s[before[1]] + 0.5, s[after[0]] - 0.5)
        for before, after in itertools.pairwise(islands)
        if covered[before[1] + 1 : after[0]].mean() >= 0.5
    ]
    if len(gaps) > 1:
        gaps.append((gaps[0][0], gaps[-1][1]))
    if not gaps:  # the rod hides nothing, or only one of its ends: take the object's chord beside the rod
        chord = _along(line, s, on_object, beside_px=line.width_px / 2 + 2)
        gaps = [(s[a] - 0.5, s[b] + 0.5) for a, b in _stretches(chord)]
    return sorted((gap for gap in gaps if gap[1] - gap[0] >= _MIN_GAP_PX), key=lambda gap: gap[0] - gap[1])


def rectangle(ends: Array, camera: CameraModel, station: Station) -> Rectangle:
    """Return the grasp rectangle of a run, given by its ends (2, 3) [m] in the ``color`` frame.

    Its width is compliance x run plus the margin at both ends; its height is the finger's width at the contacts' depth.
    """
    start_px, end_px = project(ends, camera)
    along_px = end_px - start_px
    u, v = (start_px + end_px) / 2
    margin_px = station.perception.rectangle_margin_m * camera.fx / ends[:, 2].mean()
    return Rectangle(
        center_px=(float(u), float(v)),
        angle_rad=float(np.arctan2(along_px[1], along_px[0]) % np.pi),
        width_px=float(station.perception.compliance * np.linalg.norm(along_px) + 2 * margin_px),
        height_px=float(station.hand.finger_width_m * camera.fx / ends[:, 2].mean()),
    )


def rod_depth(line: Line, rod: Mask, depth_m: npt.NDArray[np.float32]) -> Array:
    """(slope, offset) of the rod's inverse depth, 1/z = slope * s + offset, which is linear for a straight rod.

    The rod's rim, where depths mix, is left out; the fit is trimmed once.

    Args:
        rod: (H, W) mask. ``depth_m``: (H, W) z-depth.

    Returns:
        (2,): [1/(m px)] and [1/m].

    Raises: CycleFailure(MODEL_NO_ROD) without depth at two places of it.
    """
    v, u = np.nonzero(rod & np.isfinite(depth_m) & (depth_m > 0))
    pixels = np.stack([u, v], axis=1) - line.center_px
    core = np.abs(pixels @ np.array([-line.direction[1], line.direction[0]])) < 0.3 * line.width_px
    s, inverse_z = pixels[core] @ line.direction, 1.0 / depth_m[v[core], u[core]].astype(float)
    if len(s) == 0 or np.ptp(s) == 0:
        raise CycleFailure(Code.MODEL_NO_ROD, "The goal image has no depth where its rod is.")
    coefficients = np.polyfit(s, inverse_z, 1)
    residual = np.abs(np.polyval(coefficients, s) - inverse_z)
    keep = residual <= 2 * np.median(residual) + 1e-9
    return np.asarray(np.polyfit(s[keep], inverse_z[keep], 1))


def lift_run(line: Line, run: tuple[float, float], inverse_depth: Array, camera: CameraModel) -> Array:
    """End points (2, 3) [m] of a run in the ``color`` frame, on the rod's axis: one radius behind its visible side.

    Args:
        run: (start, end) along the line [px]. ``inverse_depth``: (2,), of `rod_depth`.
    """
    s = np.array(run)
    surface_m = 1.0 / np.polyval(inverse_depth, s)
    return lift_pixels(line.at(s), surface_m * (1 + line.width_px / 2 / camera.fx), camera)


def _along(line: Line, s: Array, mask: Mask, beside_px: float = 1.0) -> Mask:
    """Whether the mask is set on the line or ``beside_px`` to either side of it, at each step ``s`` (n,)."""
    normal = np.array([-line.direction[1], line.direction[0]])
    hit = np.zeros(len(s), dtype=bool)
    for side in (-beside_px, 0.0, beside_px):
        pixels = np.rint(line.at(s) + side * normal).astype(int)
        inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < mask.shape[1]) & (pixels[:, 1] < mask.shape[0])
        hit[inside] |= mask[pixels[inside, 1], pixels[inside, 0]]
    return hit


def _stretches(hit: Mask) -> list[tuple[int, int]]:
    """First and last index of every uninterrupted stretch of ``hit`` (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hit.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
