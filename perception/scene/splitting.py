"""Tells touching things apart on the height map: by steps, by valleys between two rises, and by colour."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from perception.scene.heightmap import CELL_M, Heights, Labels

_STEP_M = 0.005
"""A step from one cell to the next that parts two pieces: steeper than 68 degrees."""
_VALLEY_M, _ACROSS_CELLS = 0.0025, 3
"""A cell is a valley when the mean of the two points 6 mm to either side is so much higher."""
_FAR_BELOW_M = -10.0
_GROWN_CELLS = 6
_MIN_CELLS = 25
"""1 cm2: smaller pieces belong to the instance beside them."""
_COLOR_STEP = 14.0
"""CIE76 distance inside 6 mm at which an even patch of colour ends."""
_SMOOTH_PX = 3
_MIN_BORDER = 3
_VESSEL_M2, _INSIDE_SHARE, _GAP_CELLS = 0.03, 0.7, 9
_ALIKE, _SMALL_CELLS = 10.0, 300
_SHADED = np.array([0.3, 1.0, 1.0])
"""Lightness counts less than hue: a thing's levels are lit differently."""

Mask = npt.NDArray[np.bool_]


def pieces(surface_m: Heights, raised: Mask) -> Labels:
    """Number (ny, nx) the pieces of the raised cells that steps and valleys part, from 1 on; 0 = none.

    Args:
        surface_m: (ny, nx) heights. ``raised``: (ny, nx) the cells above the table that may belong to an object.
    """
    smooth = cv2.medianBlur(surface_m, _SMOOTH_PX)
    inside = raised & ~_valleys(cv2.GaussianBlur(smooth, (0, 0), 1.0), raised)
    return _grown(_without_steps(smooth, inside), raised)


def things(parts: Labels, lab: npt.NDArray[np.float32]) -> Labels:
    """Number (ny, nx) the things that pieces (ny, nx) make up, from 1 on, the largest first; 0 = none.

    Pieces that touch are one thing when they have one colour; a small one belongs to the neighbour it is most like: a
    stapler has levels, a drone thin arms. That no grasp reaches over a valley between two pieces depends on neither.

    Args:
        lab: (ny, nx, 3) CIELAB.
    """
    count = int(parts.max(initial=0)) + 1
    area = np.bincount(parts.ravel(), minlength=count).astype(float)
    total = [np.bincount(parts.ravel(), lab[..., axis].ravel(), count) for axis in range(3)]
    color = np.stack(total, axis=1) / np.maximum(area, 1)[:, None] * _SHADED
    apart = np.linalg.norm(color[:, None] - color[None], axis=2)
    border = _borders(parts, count)
    together = (border >= _MIN_BORDER) & (apart < _ALIKE)
    small = np.flatnonzero((area < _SMALL_CELLS) & (border.max(axis=1) >= _MIN_BORDER))
    likest = np.where(border >= _MIN_BORDER, apart, np.inf)[small].argmin(axis=1)
    together[small, likest] = True  # with one neighbour only, so that it joins no two others
    together[0], together[:, 0] = False, False
    _, group = connected_components(together, directed=False)
    group = np.asarray(group, dtype=np.int32) + 1
    group[0] = 0
    return _by_size(_with_insides(np.asarray(group[parts])))


def _with_insides(labels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """The things (ny, nx), each with what lies inside its outline: a cup with its floor, a box with what is in it."""
    labels = labels.copy()
    sizes = np.bincount(labels.ravel())
    windows = ndimage.find_objects(labels)
    for label in np.argsort(-sizes, kind="stable"):
        window = windows[label - 1] if label else None
        if window is None or not (labels[window] == label).any():
            continue
        whole = _outline_filled(labels[window] == label)
        if whole.sum() * CELL_M**2 > _VESSEL_M2:  # a bin, not a vessel
            continue
        inside = np.bincount(labels[window][whole], minlength=len(sizes)) > _INSIDE_SHARE * np.maximum(sizes, 1)
        inside[0] = False
        labels[inside[labels]] = label
    return labels


def _outline_filled(ours: Mask) -> Mask:
    """A thing (ny, nx) with everything inside its outline, which may have gaps where its rim was not seen."""
    framed = np.pad(ours.astype(np.uint8), _GAP_CELLS)
    closed = cv2.morphologyEx(framed, cv2.MORPH_CLOSE, np.ones((_GAP_CELLS, _GAP_CELLS), np.uint8))
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = cv2.drawContours(np.zeros_like(closed), contours, -1, 1, cv2.FILLED)
    return np.asarray(whole[_GAP_CELLS:-_GAP_CELLS, _GAP_CELLS:-_GAP_CELLS] > 0)


def _borders(parts: Labels, count: int) -> npt.NDArray[np.int64]:
    """Count the neighbouring cells (k, k) that each two pieces have."""
    border = np.zeros((count, count), dtype=np.int64)
    for one, other in ((parts[:, 1:], parts[:, :-1]), (parts[1:], parts[:-1])):
        between = (one != other) & (one > 0) & (other > 0)
        np.add.at(border, (one[between], other[between]), 1)
    return border + border.T


def color_patches(lab: npt.NDArray[np.float32], raised: Mask) -> Labels:
    """Number (ny, nx) the even patches of colour among the raised cells, from 1 on; 0 = none.

    Args:
        lab: (ny, nx, 3) CIELAB.
    """
    smooth = np.asarray(cv2.medianBlur(lab.clip(-127, 127).astype(np.float32), _SMOOTH_PX))
    apart = np.zeros(raised.shape, dtype=np.float32)
    for axis in (0, 1):
        difference = np.linalg.norm(np.roll(smooth, 1, axis) - np.roll(smooth, -2, axis), axis=2)
        both = np.roll(raised, 1, axis) & np.roll(raised, -2, axis)
        apart = np.maximum(apart, np.where(both, difference, 0))
    even = (raised & (apart < _COLOR_STEP)).astype(np.uint8)
    return _grown(cv2.connectedComponents(even, connectivity=4)[1], raised)


def _without_steps(smooth: Heights, inside: Mask) -> npt.NDArray[np.int32]:
    """Components (ny, nx) of the cells ``inside`` between whose neighbours there is no step, from 1 on; 0 = none."""
    cells = np.full(inside.shape, -1, dtype=np.int32)
    cells[inside] = np.arange(int(inside.sum()), dtype=np.int32)
    pairs = []
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        level = inside[one] & inside[other] & (np.abs(smooth[one] - smooth[other]) < _STEP_M)
        pairs.append(np.stack([cells[one][level], cells[other][level]]))
    first, second = np.concatenate(pairs, axis=1)
    count = int(inside.sum())
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    labels = np.zeros(inside.shape, dtype=np.int32)
    labels[inside] = group + 1
    return labels


def _valleys(smooth: Heights, raised: Mask) -> Mask:
    """Cells between two rises, along any of four directions."""
    low = np.where(raised, smooth, np.float32(_FAR_BELOW_M))
    valley = np.zeros(raised.shape, dtype=bool)
    reach = _ACROSS_CELLS
    padded = np.pad(low, reach, constant_values=_FAR_BELOW_M)
    ny, nx = raised.shape
    for dy, dx in ((0, reach), (reach, 0), (2, 2), (2, -2)):
        one = padded[reach + dy : reach + dy + ny, reach + dx : reach + dx + nx]
        other = padded[reach - dy : reach - dy + ny, reach - dx : reach - dx + nx]
        valley |= (one + other) / 2 - smooth > _VALLEY_M
    return valley & raised


def _grown(labels: npt.NDArray[np.int32], raised: Mask) -> Labels:
    """The components that are large enough, grown over the other raised cells; the largest has the number 1."""
    labels = _large(labels)
    _grow(labels, raised, _GROWN_CELLS)
    _, rest = cv2.connectedComponents((raised & (labels == 0)).astype(np.uint8), connectivity=8)
    labels = _large(np.where(rest > 0, labels.max() + rest, labels))
    _grow(labels, raised, 2 * _GROWN_CELLS)
    return _by_size(labels)


def _large(labels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """The components of at least `_MIN_CELLS`; 0 in the others."""
    return np.where(np.bincount(labels.ravel())[labels] < _MIN_CELLS, 0, labels).astype(np.int32)


def _grow(labels: npt.NDArray[np.int32], raised: Mask, reach: int) -> None:
    """Give raised cells without a number that of the nearest numbered cell, within ``reach`` cells."""
    if not labels.any():
        return
    distance, nearest = ndimage.distance_transform_edt(labels == 0, return_indices=True)
    grown = raised & (labels == 0) & (distance <= reach)
    labels[grown] = labels[tuple(nearest)][grown]


def _by_size(labels: npt.NDArray[np.int32]) -> Labels:
    areas = np.bincount(labels.ravel(), minlength=1)
    areas[0] = 0
    order = np.argsort(-areas, kind="stable")
    kept = order[areas[order] * CELL_M**2 >= _MIN_CELLS * CELL_M**2]
    number = np.zeros(len(areas), dtype=np.int16)
    number[kept] = np.arange(1, len(kept) + 1)
    return np.asarray(number[labels])
