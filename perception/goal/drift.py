"""Measures how far a goal image deviates from the observed image, and refuses it above a limit.

Masks are advisory for every hosted model, so the parts that had to stay are checked afterwards: the background, the
object's outline and its colour. A turned or shifted object is accepted (alignment corrects it); another object is not.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Alignment, Drift
from config.perception import DriftSettings
from perception.align.base import Shape
from perception.align.silhouette import Similarity, outline, silhouette_fits
from perception.geometry.crop import Mask
from perception.geometry.window import Window
from perception.goal.parts import GoalParts, background_color
from perception.observed_object import ObservedObject

_CHANGED = 24
_UNMOVED_BONUS = 0.02
"""Overlap (IoU) by which a turned fit must exceed the unmoved one."""

NO_DRIFT = Drift(
    changed_outside=0.0, other_objects=0.0, silhouette_iou=1.0, shift_px=0.0, turn_rad=0.0, scale=1.0, color_shift=0.0
)
NOTHING_MOVED = Alignment(
    method="painted",
    observed_from_goal=np.eye(4),
    scale=1.0,
    chamfer_m2=0.0,
    goal_to_observed_m=0.0,
    observed_to_goal_m=0.0,
    residual=0.0,
    hypotheses=0,
    took_s=0.0,
)
"""Drift and alignment of a model that painted its rod into the observed image."""

Image = npt.NDArray[np.uint8]


def register(goal: Shape, observed: Mask) -> tuple[Similarity, float]:
    """Return the similarity that lays the imagined outline on the observed mask (H, W), and their IoU (0 to 1)."""
    silhouette = outline(goal)
    center_px = np.zeros(2)
    unmoved = Similarity(0.0, 1.0, center_px, center_px)
    candidates = [unmoved, *silhouette_fits(silhouette, observed, 2)]
    overlaps = [_overlap(silhouette, observed, fit) for fit in candidates]
    overlaps[0] += _UNMOVED_BONUS
    best = int(np.argmax(overlaps))
    return candidates[best], overlaps[best] - (_UNMOVED_BONUS if best == 0 else 0.0)


def measure(image: Image, parts: GoalParts, observed_object: ObservedObject, fit: Similarity, overlap: float) -> Drift:
    """Measure the drift of a goal image (H, W, 3); ``fit`` and ``overlap`` (IoU) come from `register`."""
    observed = observed_object.mask
    rows, columns = np.nonzero(parts.object)
    center_px = np.array([columns.mean(), rows.mean()])
    return Drift(
        changed_outside=_changed_outside(image, parts, observed_object),
        other_objects=float(parts.others.sum() / parts.object.sum()),
        silhouette_iou=overlap,
        shift_px=float(np.linalg.norm(fit(center_px[None])[0] - center_px)),
        turn_rad=abs(fit.angle_rad),
        scale=fit.scale,
        color_shift=float(
            np.linalg.norm(_median_lab(image[parts.object]) - _median_lab(observed_object.masked[observed]))
        ),
    )


def require_faithful(drift: Drift, limits: DriftSettings) -> None:
    """Refuse a goal image that exceeds a limit. Raises: CycleFailure(MODEL_DRIFT), listing what exceeds."""
    faults = [
        (drift.changed_outside > limits.max_changed_outside, f"{drift.changed_outside:.0%} of the background changed"),
        (drift.other_objects > limits.max_other_objects, "another object appeared"),
        (
            drift.silhouette_iou < limits.min_silhouette_iou,
            f"its outline covers the observed one by {drift.silhouette_iou:.0%} only, however it is turned",
        ),
        (drift.color_shift > limits.max_color_shift, f"its colour moved by {drift.color_shift:.0f} (CIE76)"),
    ]
    found = [text for wrong, text in faults if wrong]
    if found:
        raise CycleFailure(Code.MODEL_DRIFT, f"The goal image is not of the observed object: {'; '.join(found)}.")


def _changed_outside(image: Image, parts: GoalParts, observed_object: ObservedObject) -> float:
    window = Window.around(observed_object.mask)
    ours = (observed_object.mask | parts.object | parts.others | parts.rod).astype(np.uint8)
    free = window.cut(cv2.dilate(ours, np.ones((9, 9))), 1) == 0
    background = background_color(image, window, observed_object.background)
    part = window.cut(image, observed_object.background).astype(np.int16)
    # Against the sent and against its own background: a uniform change of the whole background is no drift.
    sent = np.abs(part - np.array(observed_object.background)).max(axis=2) > _CHANGED
    even = np.abs(part - background).max(axis=2) > _CHANGED
    return float((sent & even)[free].mean()) if free.any() else 0.0


def _overlap(goal: Mask, observed: Mask, fit: Similarity) -> float:
    offset = fit(np.zeros((1, 2)))[0]
    turn = fit(np.eye(2)) - offset
    matrix = np.column_stack([turn[0], turn[1], offset])
    size = (goal.shape[1], goal.shape[0])
    moved = cv2.warpAffine(goal.astype(np.uint8), matrix, size, flags=cv2.INTER_NEAREST) > 0
    return float((moved & observed).sum() / max(int((moved | observed).sum()), 1))


def _median_lab(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    lab = cv2.cvtColor(np.ascontiguousarray(rgb[:, None]).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    return np.asarray(np.median(lab[:, 0], axis=0), dtype=float)
