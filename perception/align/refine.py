"""Local refinement of a similarity between two clouds: two-way nearest neighbours and Umeyama's closed form."""

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
"""How far from its start the scale may go, either way: unbounded, clouds shrink into each other."""


@dataclass(frozen=True)
class Pose:
    """goal -> observed: ``scale * rotation @ (diag(1, 1, relief) @ goal) + translation``, about centred clouds."""

    rotation: Array
    scale: float
    translation: Array
    relief: float = 1.0

    @property
    def matrix(self) -> Array:
        """(3, 3)."""
        return np.asarray(self.scale * self.rotation * np.array([1.0, 1.0, self.relief]))

    def __call__(self, points: Array) -> Array:
        return np.asarray(points @ self.matrix.T + self.translation)

    def between(self, goal_center: Array, observed_center: Array) -> Transform:
        """(4, 4) for clouds that are not centred."""
        return affine(self.matrix, observed_center + self.translation - self.matrix @ goal_center)


class Clouds:
    """Two centred clouds (n, 3), (m, 3) of some hundred points: every distance at once is faster than two trees.

    One instance serves one thread: its buffers are reused.
    """

    def __init__(self, goal: Array, observed: Array) -> None:
        self.goal, self.observed = goal, observed
        self._seen, self._seen_costs = _lifted(observed), _costs(observed)
        self._forth = np.empty((len(goal), len(observed)), dtype=np.float32)
        self._back = np.empty((len(observed), len(goal)), dtype=np.float32)

    def pairs(self, pose: Pose) -> tuple[Array, Array, Array]:
        """Both ways' nearest neighbours: goal points, observed points, and their distances [m] after ``pose``."""
        moved = pose(self.goal)
        forth = np.matmul(_lifted(moved), self._seen_costs, out=self._forth).argmin(axis=1)
        back = np.matmul(self._seen, _costs(moved), out=self._back).argmin(axis=1)
        goal = np.concatenate([self.goal, self.goal[back]])
        observed = np.concatenate([self.observed[forth], self.observed])
        apart = np.concatenate([moved, moved[back]]) - observed
        return goal, observed, np.sqrt(np.einsum("ij,ij->i", apart, apart))

    def loss_m(self, pose: Pose) -> float:
        """Two-way trimmed mean distance."""
        distances = self.pairs(pose)[2]
        return (trimmed_mean(distances[: len(self.goal)]) + trimmed_mean(distances[len(self.goal) :])) / 2

    def refine(self, start: Pose, iterations: int, *, relief: bool, rescale: bool, begin: int = 0) -> Pose:
        """``iterations`` steps from ``start``, counted from ``begin`` (trimming and relief set in later)."""
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
    """(n, 4): the points and a 1."""
    return np.column_stack([points, np.ones(len(points))]).astype(np.float32)


def _costs(points: Array) -> npt.NDArray[np.float32]:
    """(4, n): times `_lifted` of others, |b|^2 - 2 a.b - the squared distance less |a|^2, which ranks the same."""
    return np.vstack([-2 * points.T, np.einsum("ij,ij->i", points, points)]).astype(np.float32)


def _umeyama(goal: Array, observed: Array, pose: Pose, start_scale: float, rescale: bool) -> Pose:
    """Umeyama 1991, the relief kept as it is; the scale bounded around its start, or kept."""
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
    """The stretch along the goal's optical axis that fits best with everything else fixed, bounded."""
    flat = pose.scale * goal[:, :2] @ pose.rotation[:, :2].T + pose.translation
    along = pose.scale * np.multiply.outer(goal[:, 2], pose.rotation[:, 2])
    relief = float(((observed - flat) * along).sum() / max((along**2).sum(), 1e-12))
    return Pose(pose.rotation, pose.scale, pose.translation, float(np.clip(relief, *_RELIEF)))
