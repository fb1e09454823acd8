"""Numerical inverse kinematics of an arm of revolute joints, from its model alone. Frames: docs/frames.md.

Newton's method on many configurations at once, from evenly spread starts; the same model and pose give the same
solutions. It finds most solutions of a pose, not surely all: an arm with a closed form (`planning.kinematics`) does.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from bus.arrays import Joints, JointSamples
from config.limits import JointLimits

Array = npt.NDArray[np.float64]

_STARTS = 48
_ITERATIONS = 24
_MAX_STEP_RAD = 0.6
_DAMPING = 1e-3
_CLOSE = 1e-9
"""Largest error of a solution [m, rad]."""
_SAME_RAD = 0.02
_MAX_LINE_STEP_RAD = 0.25


class SerialArm:
    """An arm whose joints turn about the z axes of their links.

    Args:
        model: of Pinocchio; its first joints are the arm's. ``flange_frame``: index of its flange.
        limits: of the joints.
    """

    def __init__(self, model: pin.Model, flange_frame: int, limits: JointLimits) -> None:
        self.limits = limits
        count = limits.joints
        self._fixed = np.stack([model.jointPlacements[joint].homogeneous for joint in range(1, count + 1)])
        self._flange = np.asarray(model.frames[flange_frame].placement.homogeneous)
        spread = qmc.Halton(count, scramble=False).random(_STARTS + 1)[1:]
        self._starts_rad = limits.lower_rad + spread * (limits.upper_rad - limits.lower_rad)

    def solutions(self, base_from_flange: Array, margin_rad: float) -> tuple[JointSamples, npt.NDArray[np.int64]]:
        """Return configurations (k, n) that bring the flange to one of the poses (p, 4, 4), and each one's pose (k,).

        Args:
            margin_rad: distance that they keep from the position limits.
        """
        poses, starts = len(base_from_flange), len(self._starts_rad)
        targets = np.repeat(base_from_flange, starts, axis=0)
        q = self._solved(targets, np.tile(self._starts_rad, (poses, 1)))
        owner = np.repeat(np.arange(poses), starts)
        with np.errstate(invalid="ignore"):
            inside = (q >= self.limits.lower_rad + margin_rad) & (q <= self.limits.upper_rad - margin_rad)
        kept = _first_of_each(q, owner, np.flatnonzero(inside.all(axis=1)))
        return q[kept], owner[kept]

    def line(self, q_from_rad: Joints, base_from_flange: Array) -> JointSamples | None:
        """Return the path (m, n) through the poses (m, 4, 4), of which the start is at the first; None without one."""
        q_rad = [q_from_rad]
        for pose in base_from_flange[1:]:
            q = self._solved(pose[None], q_rad[-1][None])[0]
            if not np.abs(q - q_rad[-1]).max() <= _MAX_LINE_STEP_RAD:  # NaN, too
                return None
            q_rad.append(q)
        line = np.array(q_rad)
        return line if self.limits.outside(line) is None else None

    def manipulability(self, q_rad: JointSamples) -> Array:
        """Return Yoshikawa's measure ``sqrt(det(J Jt))`` (k,) of the flange; 0 = singular."""
        jacobian, _ = self._jacobian(q_rad)
        return np.asarray(np.abs(np.linalg.det(jacobian @ jacobian.swapaxes(-1, -2))) ** 0.5)

    def _solved(self, targets: Array, q_rad: JointSamples) -> JointSamples:
        """Return the configurations (k, n) in -pi to pi that the starts (k, n) lead to; NaN where they lead nowhere."""
        q, moving = q_rad.copy(), np.arange(len(q_rad))
        for _ in range(_ITERATIONS):
            jacobian, flange = self._jacobian(q[moving])
            error = _error(flange, targets[moving])
            far = np.abs(error).max(axis=1) > _CLOSE
            moving, error, jacobian = moving[far], error[far], jacobian[far]
            if not len(moving):
                break
            q[moving] += _step(jacobian, error)
        q[moving] = np.nan
        return (q + np.pi) % (2 * np.pi) - np.pi

    def _jacobian(self, q_rad: JointSamples) -> tuple[Array, Array]:
        """Return the flange's Jacobians (k, 6, n) in ``base``, and its poses (k, 4, 4)."""
        pose = np.broadcast_to(np.eye(4), (len(q_rad), 4, 4))
        frames = []
        for fixed, q in zip(self._fixed, q_rad.T, strict=True):
            turn = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
            turn[:, 0, 0] = turn[:, 1, 1] = np.cos(q)
            turn[:, 1, 0] = np.sin(q)
            turn[:, 0, 1] = -turn[:, 1, 0]
            pose = pose @ fixed @ turn
            frames.append(pose)
        flange = pose @ self._flange
        joints = np.stack(frames, axis=1)
        axes, origins = joints[..., :3, 2], joints[..., :3, 3]
        arms = flange[:, None, :3, 3] - origins
        return np.concatenate([np.cross(axes, arms), axes], axis=-1).swapaxes(-1, -2), flange


def _error(flange: Array, targets: Array) -> Array:
    """Return what turns the poses (k, 4, 4) into their targets: (k, 6) [m, rad] in ``base``."""
    turn = Rotation.from_matrix(targets[:, :3, :3] @ flange[:, :3, :3].swapaxes(-1, -2)).as_rotvec()
    return np.concatenate([targets[:, :3, 3] - flange[:, :3, 3], turn], axis=1)


def _step(jacobian: Array, error: Array) -> Array:
    """Return damped Newton steps (k, n), none of which turns a joint by more than `_MAX_STEP_RAD`."""
    near = np.minimum(1.0, np.linalg.norm(error, axis=1))[:, None, None]  # the damping fades out
    squared = jacobian @ jacobian.swapaxes(-1, -2) + _DAMPING * near * np.eye(6)
    step = (jacobian.swapaxes(-1, -2) @ np.linalg.solve(squared, error[..., None]))[..., 0]
    return np.asarray(step * np.minimum(1.0, _MAX_STEP_RAD / np.abs(step).max(axis=1))[:, None])


def _first_of_each(q: JointSamples, owner: npt.NDArray[np.int64], rows: npt.NDArray[np.int64]) -> list[int]:
    """Return those of the ``rows`` that are not the same configuration of the same pose as one before."""
    kept: list[int] = []
    for row in rows:
        if not any(owner[row] == owner[one] and np.abs(q[row] - q[one]).max() < _SAME_RAD for one in kept):
            kept.append(int(row))
    return kept
