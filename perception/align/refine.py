"""Local refinement of a similarity between two clouds: two-way nearest neighbours and Umeyama's closed form.

Points are in metres, each cloud relative to its own centre, axes as in the ``color`` frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.transforms import affine
from perception.align.base import TRIM, Array, trimmed_mean

_TRIM_FROM, _RELIEF_FROM = 3, 4
_RELIEF = (0.6, 1.7)
_SCALE_RANGE = 2.0
"""Largest change of the scale from its start, in either direction: unbounded, both clouds shrink into each other."""


@dataclass(frozen=True)
class Pose:
    """goal -> observed: ``scale * rotation @ (diag(1, 1, relief) @ goal) + translation``, for centred clouds.

    Attributes:
        rotation: (3, 3).
        scale: dimensionless. ``translation``: (3,) [m].
        relief: stretch of the goal along its optical axis, dimensionless.
    """

    rotation: Array
    scale: float
    translation: Array
    relief: float = 1.0

    @property
    def matrix(self) -> Array:
        """The linear part (3, 3): scale, rotation and relief."""
        return np.asarray(self.scale * self.rotation * np.array([1.0, 1.0, self.relief]))

    def __call__(self, points: Array) -> Array:
        return np.asarray(points @ self.matrix.T + self.translation)

    def between(self, goal_center: Array, observed_center: Array) -> Transform:
        """Return the map (4, 4) between clouds that are not centred; ``goal_center``, ``observed_center``: (3,) [m]."""
        return affine(self.matrix, observed_center + self.translation - self.matrix @ goal_center)


class Clouds:
    """Two centred clouds (n, 3), (m, 3) [m] of a few hundred points.

    All distances are computed at once, which is faster than two trees at this size. One instance serves one thread,
    because it reuses its buffers.
    """

    def __init__(self, goal: Array, observed: Array) -> None:
        self.goal, self.observed = goal, observed
        self._seen, self._seen_costs = _lifted(observed), _costs(observed)
        self._forth = np.empty((len(goal), len(observed)), dtype=np.float32)
        self._back = np.empty((len(observed), len(goal)), dtype=np.float32)

    def pairs(self, pose: Pose) -> tuple[Array, Array, Array]:
        """Nearest neighbours in both directions: goal points, observed points, their distances [m] under ``pose``."""
        moved = pose(self.goal)
        forth = np.matmul(_lifted(moved), self._seen_costs, out=self._forth).argmin(axis=1)
        back = np.matmul(self._seen, _costs(moved), out=self._back).argmin(axis=1)
        goal = np.concatenate([self.goal, self.goal[back]])
        observed = np.concatenate([self.observed[forth], self.observed])
        apart = np.concatenate([moved, moved[back]]) - observed
        return goal, observed, np.sqrt(np.einsum("ij,ij->i", apart, apart))

    def loss_m(self, pose: Pose) -> float:
        """Two-way trimmed mean distance [m] after ``pose``."""
        distances = self.pairs(pose)[2]
        return (trimmed_mean(distances[: len(self.goal)]) + trimmed_mean(distances[len(self.goal) :])) / 2

    def refine(self, start: Pose, iterations: int, *, relief: bool, rescale: bool, begin: int = 0) -> Pose:
        """Refine ``start`` by closest points and Umeyama's closed form.

        Args:
            iterations: number of steps.
            relief: fit the stretch along the goal's optical axis, too.
            rescale: fit the scale, too.
            begin: number of the first step; trimming begins at step 3, the relief at step 4.
        """
        pose = start
        for step in range(begin, begin + iterations):
            goal, observed, distances = self.pairs(pose)
            if step >= _TRIM_FROM:
                kept = int(TRIM * len(distances))
                keep = np.argpartition(distances, kept)[:kept]
                goal, observed = goal[keep], observed[keep]
            pose = _umeyama(goal, observed, pose, start.scale, rescale)
            if relief and step >= _RELIEF_FROM:
                pose = _with_relief(goal, observed, pose)
        return pose


def _lifted(points: Array) -> npt.NDArray[np.float32]:
    """(n, 4): the points (n, 3) with a 1 appended."""
    return np.column_stack([points, np.ones(len(points))]).astype(np.float32)


def _costs(points: Array) -> npt.NDArray[np.float32]:
    """(4, n): multiplied by `_lifted` points a it gives |b|^2 - 2 a.b, which ranks as the squared distance does."""
    return np.vstack([-2 * points.T, np.einsum("ij,ij->i", points, points)]).astype(np.float32)


def _umeyama(goal: Array, observed: Array, pose: Pose, start_scale: float, rescale: bool) -> Pose:
    """Umeyama's closed form (1991) with the relief kept; the scale is bounded around its start, or kept."""
    goal = goal * np.array([1.0, 1.0, pose.relief])
    goal_mean, observed_mean = goal.sum(axis=0) / len(goal), observed.sum(axis=0) / len(observed)
    goal_off, observed_off = goal - goal_mean, observed - observed_mean
    u, singular, vt = np.linalg.svd(observed_off.T @ goal_off)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * signs) @ vt
    scale = pose.scale
    if rescale:
        free = float((singular * signs).sum() / max((goal_off**2).sum(), 1e-12))
        scale = float(np.clip(free, start_scale / _SCALE_RANGE, start_scale * _SCALE_RANGE))
    return Pose(rotation, scale, observed_mean - scale * rotation @ goal_mean, pose.relief)


def _with_relief(goal: Array, observed: Array, pose: Pose) -> Pose:
    """The pose with the best-fitting relief, everything else fixed; the relief is bounded by `_RELIEF`."""
    flat = pose.scale * goal[:, :2] @ pose.rotation[:, :2].T + pose.translation
    along = pose.scale * np.multiply.outer(goal[:, 2], pose.rotation[:, 2])
    relief = float(((observed - flat) * along).sum() / max((along**2).sum(), 1e-12))
    return Pose(pose.rotation, pose.scale, pose.translation, float(np.clip(relief, *_RELIEF)))
