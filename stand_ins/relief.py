"""Images of moved objects: colours extended beyond their rim, poses, and a flat mask rendered as a rounded body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from .asked import Image, Mask

Floats = npt.NDArray[np.float64]
Plane = npt.NDArray[np.float32]

_LEVELS = 48
"""Heights at which a ray looks for the body's surface."""
_FULLNESS = 0.8
"""Height of the body over half its width."""
_SMOOTHING = 0.12
_OUTSIDE, _FALL = -40.0, 8.0
_RIM_PX = 1.2


class Layer(NamedTuple):
    """Colours (H, W, 3) and how much of each pixel they cover (H, W), 0-1."""

    color: Image
    cover: Plane

    def over(self, below: Image) -> Image:
        """Laid on a picture."""
        cover = self.cover[..., None]
        return np.asarray(np.round(self.color * cover + below * (1 - cover)), dtype=np.uint8)


@dataclass(frozen=True)
class Pose:
    """The pose of something: stretched, turned out of the image plane, turned in it, shifted.

    Attributes:
        center: (2,) what everything turns about. ``moved``: (2,) where it ends.
        turn: (2, 2) scale and rotation in the image. ``stretch``: (2, 2).
        axis: (2,) unit; the tilt turns about it. ``tilt_rad``: 0 = the object stays as it is seen.
    """

    center: Floats
    moved: Floats
    turn: Floats
    stretch: Floats
    axis: Floats
    tilt_rad: float = 0.0

    @property
    def matrix(self) -> Floats:
        """(2, 2) of everything in the image plane, foreshortening included."""
        across = np.array([-self.axis[1], self.axis[0]])
        shortened = np.eye(2) - (1 - np.cos(self.tilt_rad)) * np.outer(across, across)
        return np.asarray(self.turn @ shortened @ self.stretch)

    @property
    def per_height(self) -> Floats:
        """(2,) how far in the source one looks aside for each pixel of height."""
        across = np.array([-self.axis[1], self.axis[0]])
        return np.asarray(np.linalg.inv(self.stretch) @ across * np.tan(self.tilt_rad))

    def sources(self, shape: tuple[int, ...]) -> tuple[Plane, Plane]:
        """For each pixel of the result, x and y in the source."""
        back = np.linalg.inv(self.matrix)
        y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
        x, y = x - np.float32(self.moved[0]), y - np.float32(self.moved[1])
        return (
            np.asarray(back[0, 0] * x + back[0, 1] * y + self.center[0], dtype=np.float32),
            np.asarray(back[1, 0] * x + back[1, 1] * y + self.center[1], dtype=np.float32),
        )


def spread(image: Image, mask: Mask) -> Image:
    """The colours under the mask; outside, that of the nearest pixel under it."""
    _, labels = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    palette = np.zeros((labels.max() + 1, 3), dtype=np.uint8)
    palette[labels[mask]] = image[mask]
    return np.asarray(palette[labels])


def soft(mask: Mask) -> Plane:
    """The mask with a rim that is not all or nothing."""
    return np.asarray(cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7))


def flat(image: Image, mask: Mask, pose: Pose) -> Layer:
    """Return what lies in the object's middle plane, moved. ``image`` has colours beyond the mask."""
    x, y = pose.sources(mask.shape)
    color = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Layer(np.asarray(color, dtype=np.uint8), np.asarray(cv2.remap(soft(mask), x, y, cv2.INTER_LINEAR)))


def body(image: Image, mask: Mask, pose: Pose) -> tuple[Layer, Plane]:
    """The object moved, and where its near half is: that hides what lies in its middle plane."""
    if pose.tilt_rad == 0:
        layer = flat(image, mask, pose)
        return layer, layer.cover
    x, y = pose.sources(mask.shape)
    seen = _surface(_height(mask), x, y, pose.per_height)
    hit, level = np.isfinite(seen), np.nan_to_num(seen)
    aside = pose.per_height.astype(np.float32)
    color = cv2.remap(
        image, x - level * aside[0], y - level * aside[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return Layer(np.asarray(_past_rim(color, hit)), soft(hit)), soft(hit & (level > 0))


def _past_rim(color: npt.NDArray[np.uint8], hit: Mask) -> Image:
    """Pixels half covered take their colour from inside."""
    return spread(color, hit) if hit.any() else color


def _height(mask: Mask) -> Plane:
    """Of the near surface over the middle plane [px], falling on outside; the far one mirrors it."""
    within = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    half = max(float(within.max()), 1.0)
    rim = cv2.GaussianBlur(within - outside, (0, 0), _RIM_PX)
    deep = np.clip(np.minimum(cv2.GaussianBlur(within, (0, 0), _SMOOTHING * half), rim * 2), 0, half)
    rounded = _FULLNESS * half * np.sqrt(1 - (1 - deep / half) ** 2)
    return np.asarray(np.where(rim > 0, rounded, np.maximum(rim * _FALL, _OUTSIDE)), dtype=np.float32)


def _surface(height: Plane, x: Plane, y: Plane, per_height: Floats) -> Plane:
    """Height at which each pixel's ray first meets the body; NaN = it passes."""
    top = float(height.max())
    seen = np.full(x.shape, np.nan, dtype=np.float32)
    before, step = np.full(x.shape, _OUTSIDE, dtype=np.float32), 2 * top / (_LEVELS - 1)
    for level in np.linspace(top, -top, _LEVELS):
        source = x - np.float32(level * per_height[0]), y - np.float32(level * per_height[1])
        inside = cv2.remap(height, *source, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_OUTSIDE)
        inside = inside - np.float32(abs(level))
        new = np.isnan(seen) & (inside >= 0)
        late = inside[new] / np.maximum(inside[new] - before[new], 1e-6)
        seen[new] = np.minimum(level + step * np.clip(late, 0, 1), top)
        before = inside
    return seen
