"""Depth for goal images without depth of their own: the observed depth, transferred. In the ``color`` frame, metres."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from perception.align.silhouette import Similarity
from perception.geometry.crop import Crop
from perception.goal.parts import GoalParts
from perception.observed_object import ObservedObject

_NEAR_PX = 30

DepthImage = npt.NDArray[np.float32]


def carried_depth(parts: GoalParts, observed_object: ObservedObject, fit: Similarity) -> DepthImage:
    """Z-depth (H, W) [m] of rod and object in the goal image, NaN elsewhere.

    The object takes the observed depth of the pixel that ``fit`` (goal pixel -> observed pixel) assigns, or of the
    nearest
    observed one. The rod takes the level of the middle of the object's seen surface.
    """
    observed = np.where(observed_object.mask, observed_object.rgbd.depth_m, np.nan)
    rows, columns = np.nonzero(parts.object)
    seen_at = np.rint(fit(np.stack([columns, rows], axis=1).astype(float))).astype(int)
    nearest = _filled(observed)
    height, width = observed.shape
    depth_m = np.full(observed.shape, np.nan, dtype=np.float32)
    depth_m[rows, columns] = nearest[seen_at[:, 1].clip(0, height - 1), seen_at[:, 0].clip(0, width - 1)]
    depth_m[parts.rod] = observed_object.level_depth_m[parts.rod]
    return depth_m


def scaled_to_observed(estimated_m: DepthImage, parts: GoalParts, observed_object: ObservedObject) -> DepthImage:
    """A monocular depth estimate (H, W) [m], scaled so that its median over the object equals the observed median."""
    observed_m = float(np.nanmedian(observed_object.rgbd.depth_m[observed_object.mask]))
    return np.asarray(estimated_m * (observed_m / float(np.median(estimated_m[parts.object]))), dtype=np.float32)


def _filled(depth_m: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Depth (H, W) with every NaN replaced: by the nearest known depth near the object, by the median elsewhere."""
    known = np.isfinite(depth_m)
    crop = Crop.around(known, _NEAR_PX)
    index = ndimage.distance_transform_edt(~crop.of(known), return_distances=False, return_indices=True)
    return crop.back(crop.of(depth_m)[tuple(index)], np.full(depth_m.shape, float(np.nanmedian(depth_m))))
