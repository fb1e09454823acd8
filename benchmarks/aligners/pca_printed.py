"""The paper's alignment formula as typeset, for the record: its scale carries metres, it reflects, and it flips the
camera's axes instead of the eigenvectors' signs. `perception.align.pca` is the reading that works.
"""

from __future__ import annotations

import itertools

import numpy as np

from bus.transforms import affine
from perception.align.base import Fit, Shape
from perception.align.pca import least_chamfer, principal_axes

_ALL_SIGNS = tuple(itertools.product((1, -1), repeat=3))


def pca_cfopt_printed(goal: Shape, observed: Shape) -> Fit:
    """R_A = V_S (A V_G sqrt(L_G) L_S^-1)^-1 over all eight sign matrices A, the loss on uncentred clouds."""
    goal_values, goal_axes = principal_axes(goal.points)
    observed_values, observed_axes = principal_axes(observed.points)
    stretch = np.diag(np.sqrt(goal_values) / observed_values)
    candidates = [observed_axes @ np.linalg.inv(np.diag(signs) @ goal_axes @ stretch) for signs in _ALL_SIGNS]
    best = candidates[least_chamfer(candidates, goal.points, observed.points)]
    translation = observed.points.mean(axis=0) - best @ goal.points.mean(axis=0)
    return Fit(affine(best, translation), float(np.cbrt(abs(np.linalg.det(best)))), len(candidates))
