"""The paper's alignment: principal axes of both clouds, their signs chosen by the two-way Chamfer distance.

The reading of the paper's formula that works: R = s V_S A V_G^T with A the sign flips that make a proper rotation, one
isotropic scale, centred clouds. The formula as typeset does not work (docs/method.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from bus.transforms import affine
from perception.align.base import JUDGED_POINTS, Array, Fit, Shape, nearest
from perception.geometry.lift import subsample

_PROPER_SIGNS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))


def pca_cfopt(goal: Shape, observed: Shape) -> Fit:
    """Align with proper rotations, one scale and centred clouds: the working reading of the paper's section III-B."""
    goal_values, goal_axes = principal_axes(goal.points)
    observed_values, observed_axes = principal_axes(observed.points)
    scale = float(np.sqrt(observed_values.sum() / goal_values.sum()))
    candidates = [scale * observed_axes @ np.diag(signs) @ goal_axes.T for signs in _PROPER_SIGNS]
    goal_mean, observed_mean = goal.points.mean(axis=0), observed.points.mean(axis=0)
    best = candidates[least_chamfer(candidates, goal.points - goal_mean, observed.points - observed_mean)]
    return Fit(affine(best, observed_mean - best @ goal_mean), scale, len(candidates))


def principal_axes(points: Array) -> tuple[Array, Array]:
    """Eigenvalues (3,) [m^2] and right-handed axes (3, 3) (columns), signs made reproducible (eigh's are not)."""
    values, axes = np.linalg.eigh(np.cov(points.T))
    axes = axes * np.sign(axes[np.abs(axes).argmax(axis=0), np.arange(3)])
    proper = axes if np.linalg.det(axes) > 0 else axes * np.array([1, 1, -1])
    return np.maximum(values, 1e-12), proper


def least_chamfer(candidates: Sequence[Array], goal: Array, observed: Array) -> int:
    """Index of the candidate matrix (3, 3) with the least two-way squared Chamfer distance."""
    goal, observed = subsample(goal, JUDGED_POINTS), subsample(observed, JUDGED_POINTS)
    tree = cKDTree(observed)

    def loss_m2(matrix: Array) -> float:
        moved = goal @ matrix.T
        return float((nearest(moved, tree) ** 2).mean() + (nearest(observed, cKDTree(moved)) ** 2).mean())

    return int(np.argmin([loss_m2(matrix) for matrix in candidates]))
