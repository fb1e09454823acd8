"""KISS-Matcher (Lim et al. 2025, of TEASER++'s authors) in the ``color`` frame: optional, and never a dependency.

It makes its own correspondences, of histograms of the angles between normals (FPFH), and keeps those whose distances
agree. It is rigid, so the sizes are made equal first. Its threads race: the same clouds give another answer now and
then.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.aligners.optional import Package, equal_sizes
from bus.codes import Code
from bus.errors import CycleFailure
from perception.align.base import Array, Fit, Shape

PACKAGE = Package("kiss_matcher", "KISS-Matcher", "`uv pip install --target DIR kiss-matcher`, then PYTHONPATH=DIR.")
_VOXEL = 2.0
"""Side of its voxels, in distances between neighbouring points: the best of 0.7 to 2.5 on 66 hard and 66 mild trials of
seed 1. Voxels of one size for all end its process on sparse clouds. Everything else is as it comes.
"""
_MIN_PAIRS = 3


def kiss_matcher(goal: Shape, observed: Shape) -> Fit:
    """Align with KISS-Matcher.

    Raises:
        ConfigError: KISS-Matcher is not installed.
        CycleFailure: MODEL_DRIFT for fewer than 3 correspondences.
    """
    return equal_sizes(goal, observed, partial(_solve, PACKAGE.load("kiss_matcher")))


def _solve(package: Any, goal: Array, observed: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of two clouds (n, 3), (m, 3) in rms radii. Raises: CycleFailure."""
    voxel = _VOXEL * max(_spacing(goal), _spacing(observed))
    matcher = package.KISSMatcher(package.KISSMatcherConfig(voxel_size=voxel))
    ours, theirs = matcher.match(np.ascontiguousarray(goal.T), np.ascontiguousarray(observed.T))
    if len(ours) < _MIN_PAIRS:
        raise CycleFailure(
            Code.MODEL_DRIFT, f"Only {len(ours)} points of the imagined object correspond to observed ones."
        )
    found = matcher.solve(*(np.array(points, dtype=float).T for points in (ours, theirs)))
    return np.asarray(found.rotation), np.asarray(found.translation).ravel()


def _spacing(points: Array) -> float:
    """Median distance of points (n, 3) to their nearest neighbour."""
    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
