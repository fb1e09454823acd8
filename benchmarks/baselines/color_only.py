"""The segmenter for images without depth: the region that differs from a plain surface around the middle."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from perception.geometry.crop import Mask

_SHRINK = 4
_SURFACE_SHARE = 0.45
"""Window of the surface's local colour, as a share of the shorter side: wider than objects are."""
_LIGHTNESS = 0.6
"""Weight of lightness against chroma: soft shadows are dark, but have the surface's chroma."""
_CLEAR, _FAINT = 9.0, (6.0, 4.0)
"""CIELAB distances tried in turn: what is white on white stands out by its shading only."""
_MAX_OFF = 0.3
"""From the middle, as a share of the image."""
_MIN_AREA = 3e-4
_MAX_AREA = 0.25
_BRIDGE = 0.012
_REFINEMENTS = 3

Image = npt.NDArray[np.uint8]


def segment_by_color(color: Image) -> Mask:
    """The object on a plain surface (H, W). Raises: CycleFailure(NO_OBJECT) when nothing stands out."""
    distance = _distance_to_surface(color)
    inner = distance[_middle(distance.shape)]
    scaled = np.clip(inner * 4, 0, 255).astype(np.uint8)
    otsu = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0] / 4
    for threshold in (max(_CLEAR, 0.6 * otsu), *_FAINT):
        mask = _best_component(distance > threshold, distance)
        if mask is not None:
            return _refined(color, mask)
    raise CycleFailure(Code.NO_OBJECT, "Nothing stands out from the surface in colour.")


def _distance_to_surface(color: Image) -> npt.NDArray[np.float32]:
    """Weighted CIELAB distance of every pixel to the surface's colour around it."""
    lab = cv2.cvtColor(cv2.GaussianBlur(color, (5, 5), 0).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    height, width = lab.shape[:2]
    small = cv2.resize(color, (width // _SHRINK, height // _SHRINK), interpolation=cv2.INTER_AREA)
    window = int(_SURFACE_SHARE * min(small.shape[:2])) | 1
    surface = cv2.resize(cv2.medianBlur(small, window), (width, height), interpolation=cv2.INTER_LINEAR)
    apart = lab - cv2.cvtColor(surface.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    apart[..., 0] *= _LIGHTNESS
    return np.asarray(cv2.medianBlur(np.linalg.norm(apart, axis=2).astype(np.float32), 5))


def _middle(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The middle half of the image, where the object is."""
    height, width = shape[:2]
    return slice(height // 4, height - height // 8), slice(width // 5, width - width // 5)


def _best_component(stands_out: Mask, distance: npt.NDArray[np.float32]) -> Mask | None:
    """The component that stands out most in sum, near the middle and clear of the image's rim; None = there is none."""
    height, width = stands_out.shape
    clean = cv2.morphologyEx(stands_out.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3)))
    bridge = max(3, int(_BRIDGE * min(height, width)))
    joined = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, np.ones((bridge, bridge)))
    _, labels, stats, centers = cv2.connectedComponentsWithStats(joined)
    best, best_weight = 0, 0.0
    for label, (left, top, wide, high, area) in enumerate(stats):
        touches = left == 0 or top == 0 or left + wide == width or top + high == height
        if label == 0 or touches or not _MIN_AREA < area / (height * width) < _MAX_AREA:
            continue
        off = np.hypot(centers[label][0] / width - 0.5, centers[label][1] / height - 0.5)
        if off > _MAX_OFF:
            continue
        weight = float(distance[labels == label].sum()) * float(np.exp(-((off / 0.25) ** 2)))
        if weight > best_weight:
            best, best_weight = label, weight
    return np.asarray(labels == best) if best else None


def _refined(color: Image, mask: Mask) -> Mask:
    """GrabCut around the outline; its own result only where it agrees in size."""
    rows, columns = np.nonzero(mask)
    pad = max(12, int(0.25 * max(np.ptp(rows), np.ptp(columns))))
    part = np.s_[max(0, rows.min() - pad) : rows.max() + pad, max(0, columns.min() - pad) : columns.max() + pad]
    inside = mask[part].astype(np.uint8)
    labels = np.where(cv2.dilate(inside, np.ones((9, 9))) > 0, cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
    labels[inside > 0] = cv2.GC_PR_FGD
    labels[cv2.erode(inside, np.ones((5, 5))) > 0] = cv2.GC_FGD
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(np.ascontiguousarray(color[part]), labels, None, *models, _REFINEMENTS, cv2.GC_INIT_WITH_MASK)
    found = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    if not 0.6 < found.sum() / inside.sum() < 1.6:
        return mask
    refined = np.zeros_like(mask)
    refined[part] = found
    return refined
