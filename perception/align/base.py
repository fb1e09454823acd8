"""The types that alignment works on, and the measures that judge every method.

Points are in metres in the ``color`` frame; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import CameraModel
from bus.transforms import apply
from perception.geometry.lift import lift, subsample

_MIN_POINTS = 30
JUDGED_POINTS = 800
TRIM = 0.85
"""Share of the distances that count; the rest are treated as outliers."""

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Shape:
    """One object as a camera sees it.

    Attributes:
        mask: (H, W) pixels of the object.
        hidden: (H, W) pixels that the rod covers; the object may continue below them.
        depth_m: (H, W) z-depth, NaN = unknown.
        camera: the undistorted pinhole that both images of an alignment share.
    """

    mask: Mask
    hidden: Mask
    depth_m: npt.NDArray[np.float32]
    camera: CameraModel

    @cached_property
    def points(self) -> Array:
        """(n, 3) [m] in the camera frame, of the object's pixels that have depth.

        Raises: CycleFailure(MODEL_DRIFT) for fewer than 30 points.
        """
        points = lift(self.mask, self.depth_m, self.camera)
        if len(points) < _MIN_POINTS:
            raise CycleFailure(Code.MODEL_DRIFT, f"Only {len(points)} points of the object are seen.")
        return points


class Fit(NamedTuple):
    """The result of one alignment method.

    Attributes:
        observed_from_goal: (4, 4) map of goal points onto observed points [m], scale included.
        scale: isotropic scale of that map, dimensionless.
        hypotheses: number of orientations that were tried.
    """

    observed_from_goal: Transform
    scale: float
    hypotheses: int


class Residuals(NamedTuple):
    """Distances between two aligned clouds; `bus.messages.Alignment` defines them.

    Attributes:
        chamfer_m2: sum of the two mean squared nearest-neighbour distances.
        goal_to_observed_m, observed_to_goal_m: the one-way Hausdorff distances.
        residual: two-way trimmed mean distance as a share of the observed object's rms radius.
    """

    chamfer_m2: float
    goal_to_observed_m: float
    observed_to_goal_m: float
    residual: float


def rms_radius_m(points: Array) -> float:
    """Root mean square distance [m] of points (n, 3) from their centroid."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def nearest(of: Array, to: cKDTree) -> Array:
    """Distance (n,) [m] of each point (n, 3) to the nearest point of the tree."""
    return np.asarray(to.query(of)[0])


def trimmed_mean(distances: Array) -> float:
    """Mean of the smaller 85 % (`TRIM`) of distances (n,)."""
    return float(np.sort(distances)[: max(1, int(TRIM * len(distances)))].mean())


def residuals(goal: Array, observed: Array, observed_from_goal: Transform) -> Residuals:
    """Judge a fit on at most `JUDGED_POINTS` points of each cloud.

    Args:
        goal, observed: (n, 3), (m, 3) [m].
        observed_from_goal: (4, 4).
    """
    moved, kept = subsample(apply(observed_from_goal, goal), JUDGED_POINTS), subsample(observed, JUDGED_POINTS)
    forth, back = nearest(moved, cKDTree(kept)), nearest(kept, cKDTree(moved))
    return Residuals(
        chamfer_m2=float((forth**2).mean() + (back**2).mean()),
        goal_to_observed_m=float(forth.max()),
        observed_to_goal_m=float(back.max()),
        residual=(trimmed_mean(forth) + trimmed_mean(back)) / 2 / rms_radius_m(kept),
    )
