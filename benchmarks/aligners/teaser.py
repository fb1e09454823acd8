"""TEASER++ (Yang et al. 2020) in the ``color`` frame. It has no wheel, so it is optional and never a dependency.

TEASER++ needs correspondences. They are made from distance histograms, which rotation and translation do not change.
The sizes are made equal first and its own scale estimate stays off: a degenerate one ends the process by an assertion.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from benchmarks.aligners.optional import Package, equal_sizes
from bus.codes import Code
from bus.errors import CycleFailure
from perception.align.base import Array, Fit, Shape
from perception.geometry.lift import subsample

PACKAGE = Package("teaserpp_python", "TEASER++", "Build MIT-SPARK/TEASER-plusplus with its Python bindings.")
_POINTS = 300
_BINS = 24
_FARTHEST = 3.0
"""Upper edge of the distance histograms, in rms radii."""
_NOISE = 0.08
"""Bound of a correspondence's error, in rms radii."""
_MIN_PAIRS = 10


def teaser(goal: Shape, observed: Shape) -> Fit:
    """Align with TEASER++.

    Raises:
        ConfigError: TEASER++ is not installed.
        CycleFailure: MODEL_DRIFT for fewer than 10 correspondences.
    """
    return equal_sizes(goal, observed, partial(_matched, PACKAGE.load("teaser")))


def correspondences(goal: Array, observed: Array) -> npt.NDArray[np.int64]:
    """(k, 2) indices of points of two clouds (n, 3), (m, 3) whose distance histograms are mutually nearest."""
    ours, theirs = _histograms(goal), _histograms(observed)
    forth, back = cKDTree(theirs).query(ours)[1], cKDTree(ours).query(theirs)[1]
    mutual = np.flatnonzero(back[forth] == np.arange(len(ours)))
    return np.stack([mutual, forth[mutual]], axis=1)


def _histograms(cloud: Array) -> Array:
    """(n, bins) cumulative distribution of the distances from each point to all points of its cloud (n, 3)."""
    apart = np.linalg.norm(cloud[:, None] - cloud[None], axis=2)
    edges = np.linspace(0, _FARTHEST, _BINS + 1)
    return np.stack([np.cumsum(np.histogram(row, edges)[0]) / len(cloud) for row in apart])


def _matched(package: Any, goal: Array, observed: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of two clouds (n, 3), (m, 3) in rms radii. Raises: CycleFailure."""
    ours, theirs = subsample(goal, _POINTS), subsample(observed, _POINTS)
    pairs = correspondences(ours, theirs)
    if len(pairs) < _MIN_PAIRS:
        raise CycleFailure(
            Code.MODEL_DRIFT, f"Only {len(pairs)} points of the imagined object correspond to observed ones."
        )
    return _solve(package, ours[pairs[:, 0]], theirs[pairs[:, 1]])


def _solve(package: Any, goal: Array, observed: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of corresponding points (k, 3)."""
    params = package.RobustRegistrationSolver.Params()
    params.cbar2, params.noise_bound, params.estimate_scaling = 1.0, _NOISE, False
    params.rotation_gnc_factor, params.rotation_max_iterations, params.rotation_cost_threshold = 1.4, 100, 1e-12
    solver = package.RobustRegistrationSolver(params)
    solver.solve(goal.T, observed.T)
    found = solver.getSolution()
    return np.asarray(found.rotation), np.asarray(found.translation).ravel()
