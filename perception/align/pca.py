"""The paper's alignment: principal axes of both clouds, their signs chosen by the two-way Chamfer distance.

The paper's formula has two readings. `pca_cfopt` is the one that works: R = s V_S A V_G^T with A the sign flips that
make a proper rotation, one isotropic scale, centred clouds. `pca_cfopt_printed` is the formula as typeset: its scale
has the unit metre, it can reflect, and it flips the camera's axes instead of the eigenvectors' signs.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from perception.align.base import JUDGED_POINTS, Array, Fit, Shape, affine, nearest
from perception.geometry.lift import subsample

_PROPER_SIGNS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
_ALL_SIGNS = tuple(itertools.product((1, -1), repeat=3))


def pca_cfopt(goal: Shape, observed: Shape) -> Fit:
    """Align with proper rotations, one scale and centred clouds: the working reading of the paper's section III-B."""
    goal_values, goal_axes = _principal(goal.points)
    observed_values, observed_axes = _principal(observed.points)
    scale = float(np.sqrt(observed_values.sum() / goal_values.sum()))
    candidates = [scale * observed_axes @ np.diag(signs) @ goal_axes.T for signs in _PROPER_SIGNS]
    goal_mean, observed_mean = goal.points.mean(axis=0), observed.points.mean(axis=0)
    best = candidates[_least_chamfer(candidates, goal.points - goal_mean, observed.points - observed_mean)]
    return Fit(affine(best, observed_mean - best @ goal_mean), scale, len(candidates))


def pca_cfopt_printed(goal: Shape, observed: Shape) -> Fit:
    """Align with R_A = V_S (A V_G sqrt(L_G) L_S^-1)^-1 over all eight sign matrices A; the loss on uncentred clouds."""
    goal_values, goal_axes = _principal(goal.points)
    observed_values, observed_axes = _principal(observed.points)
    stretch = np.diag(np.sqrt(goal_values) / observed_values)
    candidates = [observed_axes @ np.linalg.inv(np.diag(signs) @ goal_axes @ stretch) for signs in _ALL_SIGNS]
    best = candidates[_least_chamfer(candidates, goal.points, observed.points)]
    translation = observed.points.mean(axis=0) - best @ goal.points.mean(axis=0)
    return Fit(affine(best, translation), float(np.cbrt(abs(np.linalg.det(best)))), len(candidates))


def _principal(points: Array) -> tuple[Array, Array]:
    """Eigenvalues (3,) [m^2] and right-handed axes (3, 3) (columns), signs made reproducible (eigh's are not)."""
    values, axes = np.linalg.eigh(np.cov(points.T))
    axes = axes * np.sign(axes[np.abs(axes).argmax(axis=0), np.arange(3)])
    proper = axes if np.linalg.det(axes) > 0 else axes * np.array([1, 1, -1])
    return np.maximum(values, 1e-12), proper


def _least_chamfer(candidates: Sequence[Array], goal: Array, observed: Array) -> int:
    """Index of the candidate matrix (3, 3) with the least two-way squared Chamfer distance."""
    goal, observed = subsample(goal, JUDGED_POINTS), subsample(observed, JUDGED_POINTS)
    tree = cKDTree(observed)

    def loss_m2(matrix: Array) -> float:
        moved = goal @ matrix.T
        return float((nearest(moved, tree) ** 2).mean() + (nearest(observed, cKDTree(moved)) ** 2).mean())

    return int(np.argmin([loss_m2(matrix) for matrix in candidates]))
