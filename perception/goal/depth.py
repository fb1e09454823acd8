"""Depth for a goal image that came without: the *observed* estimator, carried over from what was really seen."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from perception.align.silhouette import Similarity
from perception.geometry.crop import Crop
from perception.goal.parts import GoalParts
from perception.subject import ObservedObject

_NEAR_PX = 30

DepthImage = npt.NDArray[np.float32]


def carried_depth(parts: GoalParts, observed_object: ObservedObject, fit: Similarity) -> DepthImage:
    """Z-depth [m] of rod and object in the goal image, NaN elsewhere.

    The object's is the observed depth where ``fit`` (goal pixel -> observed pixel) says the same part was seen, else
    that of the nearest such part; the rod lies level with the middle of the object's seen surface.
    """
    observed = np.where(observed_object.scene.object_mask, observed_object.rgbd.depth_m, np.nan)
    rows, columns = np.nonzero(parts.object)
    seen_at = np.rint(fit(np.stack([columns, rows], axis=1).astype(float))).astype(int)
    nearest = _filled(observed)
    height, width = observed.shape
    depth_m = np.full(observed.shape, np.nan, dtype=np.float32)
    depth_m[rows, columns] = nearest[seen_at[:, 1].clip(0, height - 1), seen_at[:, 0].clip(0, width - 1)]
    depth_m[parts.rod] = observed_object.level_depth_m[parts.rod]
    return depth_m


def scaled_to_observed(estimated_m: DepthImage, parts: GoalParts, observed_object: ObservedObject) -> DepthImage:
    """A monocular estimate in the observed object's depth: the two medians over the object are made equal."""
    observed_m = float(np.nanmedian(observed_object.rgbd.depth_m[observed_object.scene.object_mask]))
    return np.asarray(estimated_m * (observed_m / float(np.median(estimated_m[parts.object]))), dtype=np.float32)


def _filled(depth_m: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Every NaN replaced by the nearest known depth, near the object only."""
    known = np.isfinite(depth_m)
    crop = Crop.around(known, _NEAR_PX)
    index = ndimage.distance_transform_edt(~crop.of(known), return_distances=False, return_indices=True)
    return crop.back(crop.of(depth_m)[tuple(index)], np.full(depth_m.shape, float(np.nanmedian(depth_m))))
