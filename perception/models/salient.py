"""Salient-object networks of the U-2-Net family (Qin et al. 2020) through ONNX: the mask of what stands out."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from perception.geometry.crop import Mask
from perception.onnx_session import OnnxSession

_MEAN, _DEVIATION = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]], dtype=np.float32)
"""Of ImageNet, in 0..1 RGB."""
_SOURCE = "Fetch U-2-Net small with `just salient`, or name another .onnx file: perception.salient.path."
_NEEDED = "Needed: (1, 3, S, S) float32 -> one map (1, 1, S, S) in 0..1, or U-2-Net's seven, the final one first."
_SALIENT = 0.5
_SURE = 0.95
"""Peak of a map below which the object may be too small to be noticed: then the middle of the image is looked at alone.
(On the development images of Cornell, objects of 60 x 20 px in 640 x 480 px peak at 0.6; in the middle part, at 1.)
What the rim of the image cuts counts neither: there stand the feet of whoever watches."""
_UNSEEN = 0.5
_MIDDLE = 0.6
"""Side of that part over the image's."""
_ROOM = 1.6
"""Side of the window of the second, closer look over the object's larger extent."""
_LEAST_SIDE_PX = 96
_BAND_PX = 9
"""How far from the outline that depth gives the redrawn one may lie."""

Image = npt.NDArray[np.uint8]
Map = npt.NDArray[np.float32]


class Salient:
    """One loaded network. It has no classes and reads no words: it marks what stands out from its surroundings.

    Args:
        path: the ``.onnx`` file, e.g. u2netp.onnx (`just salient`).

    Raises: ConfigError for a missing package or file, or another network.
    """

    reads_text = False

    def __init__(self, path: Path) -> None:
        self._network = OnnxSession(path, "The segmenter 'salient'", _SOURCE, _NEEDED)
        if self._network.channels != 3 or self._network.outputs not in (1, 7):
            raise self._network.other_tensors()
        final, size_px = self._network.try_out()[0], self._network.size_px
        if final.shape != (1, 1, size_px, size_px) or not (final.min() >= 0 and final.max() <= 1):
            raise self._network.other_tensors()

    def object_of(self, image: Image) -> Mask:
        """Return the mask (H, W) of the object that stands out most in an image (H, W, 3).

        Two looks: at the whole - or at its middle, if the object is too small to be noticed -, and closer at what was
        found. Raises: CycleFailure(TARGET_NOT_FOUND) when nothing stands out.
        """
        noticed = self.noticed(image)
        if noticed is None:
            whole, peak = self._look(image, (slice(None), slice(None)))
            if peak < _UNSEEN:
                raise _unnoticed()
            noticed = _largest(whole > _SALIENT)
        return self.near(image, noticed)

    def noticed(self, image: Image) -> Mask | None:
        """Roughly where (H, W) something stands out for sure that no border cuts; None = nowhere."""
        for part in ((slice(None), slice(None)), _middle(image.shape)):
            found, peak = self._look(image, part)
            inside = _clear_of_rim((found > _SALIENT)[part])
            if inside.any() and peak * float(found[part][inside].max()) >= _SURE:
                mask = np.zeros(image.shape[:2], dtype=bool)
                mask[part] = inside
                return mask
        return None

    def near(self, image: Image, mask: Mask) -> Mask:
        """Return the largest thing that stands out around a mask (H, W). Raises: CycleFailure(TARGET_NOT_FOUND)."""
        return _required(_largest(self._closer(image, mask) > _SALIENT))

    def by_box(self, image: Image, box_px: tuple[float, float, float, float]) -> Mask:
        """Return the mask (H, W) of what stands out in a box (u0, v0, u1, v1) [px].

        Raises: CycleFailure(TARGET_NOT_FOUND).
        """
        u0, v0, u1, v1 = (round(edge) for edge in box_px)
        box = np.zeros(image.shape[:2], dtype=bool)
        box[max(0, v0) : v1 + 1, max(0, u0) : u1 + 1] = True
        return _required((self._closer(image, box) > _SALIENT) & box)

    def outlined(self, image: Image, mask: Mask) -> Mask:
        """Return the mask (H, W) of an object that depth has found, its outline redrawn.

        Depth remains the authority: what is farther than 9 px from its outline keeps the side that depth gave it, and
        when hardly anything in the mask stands out, nothing changes.
        """
        salient = self._closer(image, mask) > _SALIENT
        if not mask.any() or salient[mask].mean() < _SALIENT:
            return mask
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _BAND_PX + 1, 2 * _BAND_PX + 1))
        inner, outer = (change(mask.astype(np.uint8), kernel) > 0 for change in (cv2.erode, cv2.dilate))
        return np.asarray(inner | (salient & outer))

    def _closer(self, image: Image, mask: Mask) -> Map:
        """The map (H, W) of a window around the mask; 0 elsewhere, and everywhere for an empty mask."""
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not len(rows):
            return np.zeros(mask.shape, dtype=np.float32)
        extent = max(np.ptp(rows), np.ptp(columns)) + 1
        side = int(min(max(_ROOM * extent, _LEAST_SIDE_PX), max(mask.shape)))
        top, left = ((int(line[0]) + int(line[-1]) - side) // 2 for line in (rows, columns))
        part = np.s_[max(0, top) : top + side, max(0, left) : left + side]
        return self._look(image, part)[0]

    def _look(self, image: Image, part: tuple[slice, slice]) -> tuple[Map, float]:
        """The map (H, W) of a part of the image, stretched to 0..1 there and 0 elsewhere; and its peak before."""
        size = (self._network.size_px, self._network.size_px)
        seen = np.ascontiguousarray(image[part])
        small = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
        planes = (small / max(float(small.max()), 1.0) - _MEAN) / _DEVIATION
        found = self._network.run(planes.transpose(2, 0, 1))[0][0, 0]
        low, high = float(found.min()), float(found.max())
        whole = np.zeros(image.shape[:2], dtype=np.float32)
        stretched = (found - low) / max(high - low, 1e-6)
        whole[part] = cv2.resize(stretched, (seen.shape[1], seen.shape[0]), interpolation=cv2.INTER_LINEAR)
        return whole, high


def _middle(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The middle part of an image."""
    rows, columns = (slice(round((1 - _MIDDLE) / 2 * side), round((1 + _MIDDLE) / 2 * side)) for side in shape[:2])
    return rows, columns


def _largest(mask: Mask) -> Mask:
    """The largest connected part of a mask (H, W)."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return np.asarray(labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())) if count > 1 else mask


def _clear_of_rim(mask: Mask) -> Mask:
    """The largest connected part of a mask (H, W) that does not touch its rim."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8))
    cut = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    return _largest(mask & ~np.isin(labels, cut))


def _required(mask: Mask) -> Mask:
    if not mask.any():
        raise _unnoticed()
    return mask


def _unnoticed() -> CycleFailure:
    return CycleFailure(Code.TARGET_NOT_FOUND, "Nothing in the picture stands out from its surroundings.")
