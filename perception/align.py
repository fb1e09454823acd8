"""Stage 2 of the paper: carry the imagined object back onto the observed one by principal components (``pca_cfopt``).

The printed formula is read as R = s V_S A V_G^T with A the sign flips that make a proper rotation, one isotropic scale,
and centred clouds; signs are chosen by a correspondence-free loss (two-way Chamfer). As the goal image mostly keeps the
object where it is, the untouched orientation is a fifth candidate.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Alignment

_LOSS_POINTS = 800
_MIN_POINTS = 30
_SIGNS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))

Array = npt.NDArray[np.float64]


def align(goal: Array, observed: Array) -> Alignment:
    """The similarity that carries ``goal`` (n, 3) onto ``observed`` (m, 3), both [m] in the colour frame.

    Raises: CycleFailure(MODEL_DRIFT) when a cloud is too small to have axes.
    """
    if min(len(goal), len(observed)) < _MIN_POINTS:
        raise CycleFailure(Code.MODEL_DRIFT, f"The goal image shows only {len(goal)} points of the object.")
    goal_mean, observed_mean = goal.mean(axis=0), observed.mean(axis=0)
    goal_values, goal_axes = np.linalg.eigh(np.cov(goal.T))
    observed_values, observed_axes = np.linalg.eigh(np.cov(observed.T))
    scale = float(np.sqrt(observed_values.sum() / goal_values.sum()))
    goal_axes, observed_axes = _proper(goal_axes), _proper(observed_axes)
    rotations = [np.eye(3), *(observed_axes @ np.diag(signs) @ goal_axes.T for signs in _SIGNS)]
    few_goal, few_observed = _few(goal) - goal_mean, _few(observed) - observed_mean
    observed_tree = cKDTree(few_observed)
    losses = [_chamfer_m2(scale * few_goal @ rotation.T, few_observed, observed_tree) for rotation in rotations]
    best = int(np.argmin(losses))
    observed_from_goal = np.eye(4)
    observed_from_goal[:3, :3] = scale * rotations[best]
    observed_from_goal[:3, 3] = observed_mean - scale * rotations[best] @ goal_mean
    return Alignment(
        method="pca_cfopt", observed_from_goal=observed_from_goal, scale=scale, chamfer_m2=float(losses[best])
    )


def _proper(axes: Array) -> Array:
    """Eigenvectors with signs made reproducible (largest component positive) and a right-handed order."""
    largest = np.abs(axes).argmax(axis=0)
    axes = axes * np.sign(axes[largest, np.arange(3)])
    return axes if np.linalg.det(axes) > 0 else axes * np.array([1, 1, -1])


def _few(points: Array) -> Array:
    return points[:: max(1, -(-len(points) // _LOSS_POINTS))]


def _chamfer_m2(goal: Array, observed: Array, observed_tree: cKDTree) -> float:
    """Sum of the two mean squared nearest-neighbour distances [m^2]."""
    forth = observed_tree.query(goal)[0]
    back = cKDTree(goal).query(observed)[0]
    return float((forth**2).mean() + (back**2).mean())
