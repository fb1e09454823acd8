"""Closed-form inverse kinematics of the FR3 over its one free joint, q7. Frames: docs/frames.md.

Geometry after He & Liu, "Analytical Inverse Kinematics for Franka Emika Panda - a Geometrical Solver for 7-DOF
Manipulators with Unconventional Design", ICCMA 2021. Shoulder S (joints 1-3 meet nearly there), elbow and wrist W lie
in one plane; a given q7 fixes W, the triangle S-elbow-W fixes q4, the forearm's angle to S-W leaves two q6, and each
leaves two (q1, q2, q3): at most four solutions. The arm stretched beyond q4 = -0.47 is left out (nearly singular).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples, Transform
from config.limits import FR3, LOWER_RAD, UPPER_RAD
from planning.arm import limit_distance_rad

Array = npt.NDArray[np.float64]

# Link constants [m], franka_description ``fr3/kinematics.yaml`` (Craig's DH).
D1, D3, D5 = 0.333, 0.316, 0.384
A4, A7 = 0.0825, 0.088
FLANGE = 0.107
_RIGHT = np.pi / 2
_DH = (
    (0, 0, D1),
    (0, -_RIGHT, 0),
    (0, _RIGHT, D3),
    (A4, _RIGHT, 0),
    (-A4, -_RIGHT, D5),
    (0, _RIGHT, 0),
    (A7, _RIGHT, 0),
)
"""(a [m], alpha [rad], d [m]) of each joint."""

_MAX_LINE_STEP_RAD = 0.25
_BEND = np.arctan2(D3, A4) + np.arctan2(D5, A4)  # angle S-elbow-W of the straight arm (q4 = 0)
_UPPER_ARM, _FOREARM = np.hypot(D3, A4), np.hypot(D5, A4)


class ClosedForm:
    """The FR3 as planning asks for it (`planning.arm.Arm`): q7 is tried all over its range, and kept on a line."""

    limits = FR3

    def solutions(self, base_from_flange: Array, margin_rad: float) -> tuple[JointSamples, npt.NDArray[np.int64]]:
        """Return configurations (k, 7) of the poses (p, 4, 4), and each one's pose (k,). See `planning.arm.Arm`."""
        every = branches(base_from_flange[:, None], q7_grid())
        kept = limit_distance_rad(FR3, every) >= margin_rad
        return every[kept], np.nonzero(kept)[0]

    def line(self, q_from_rad: Joints, base_from_flange: Array) -> JointSamples | None:
        """Return the path (m, 7) through the poses (m, 4, 4), each step to the nearest branch; None without one."""
        q_rad = [q_from_rad]
        for options in branches(base_from_flange, q_from_rad[6])[1:]:
            step = np.abs(options - q_rad[-1]).max(axis=1)
            step[np.isnan(step)] = np.inf
            nearest = int(np.argmin(step))
            if step[nearest] > _MAX_LINE_STEP_RAD:
                return None
            q_rad.append(options[nearest])
        line = np.array(q_rad)
        inside = ((line >= LOWER_RAD) & (line <= UPPER_RAD)).all()
        return line if inside else None

    def manipulability(self, q_rad: JointSamples) -> Array:
        """Return Yoshikawa's measure (k,) of the flange; 0 = singular."""
        return manipulability(q_rad)


FR3_ARM = ClosedForm()


def q7_grid(count: int = 61) -> Array:
    """Return evenly spaced values of q7 (count,) [rad] inside its limits."""
    return np.linspace(LOWER_RAD[6], UPPER_RAD[6], count)


def inverse(base_from_flange: Transform, q7_rad: Array) -> JointSamples:
    """Return all solutions (k, 7) inside the position limits.

    Args:
        base_from_flange: (4, 4).
        q7_rad: (n,) values of q7 to solve for.
    """
    q = branches(base_from_flange, q7_rad).reshape(-1, 7)
    with np.errstate(invalid="ignore"):
        inside = ((q >= LOWER_RAD) & (q <= UPPER_RAD)).all(axis=1)
    return np.asarray(q[inside])


def branches(base_from_flange: Array, q7_rad: Array) -> Array:
    """Return the four solutions of each pose, inside the position limits or not.

    Args:
        base_from_flange: (..., 4, 4).
        q7_rad: (...), broadcast against it.

    Returns:
        (..., 4, 7); NaN where the pose is out of reach. Branches keep their place while the pose moves.
    """
    with np.errstate(invalid="ignore"):
        q7, x, z, wrist = _wrist(base_from_flange, q7_rad)
        q4, shoulder_x, shoulder_y = _elbow(wrist)
        q6 = _wrist_bend(x, z, wrist, shoulder_y - D5)
        # Forearm frame (joint 4), now that its direction is known: (..., 2, 3)
        x, z, wrist = x[..., None, :], z[..., None, :], wrist[..., None, :]
        sin6, cos6 = np.sin(q6)[..., None], np.cos(q6)[..., None]
        y4 = sin6 * x - cos6 * z
        x4 = (-wrist - (shoulder_y - D5)[..., None, None] * y4) / (shoulder_x + A4)[..., None, None]
        z4 = np.cross(x4, y4)
        x5 = cos6 * x + sin6 * z
        q5 = np.arctan2(-_dot(z4, x5), _dot(x4, x5))
        q1, q2, q3 = _shoulder(x4, y4, z4, q4[..., None])
    shape = q1.shape  # (..., 2, 2)
    parts = (q1, q2, q3, q4[..., None, None], q5[..., None], np.mod(q6, 2 * np.pi)[..., None], q7[..., None, None])
    q = np.stack([np.broadcast_to(part, shape) for part in parts], axis=-1)
    return np.asarray(q.reshape(*shape[:-2], 4, 7))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))


def _wrist(base_from_flange: Array, q7_rad: Array) -> tuple[Array, Array, Array, Array]:
    """Return q7, the x axis of link 6, the flange's z axis, and W - S; all broadcast."""
    shape = np.broadcast_shapes(base_from_flange.shape[:-2], q7_rad.shape)
    pose = np.broadcast_to(base_from_flange, (*shape, 4, 4))
    q7 = np.broadcast_to(q7_rad, shape)
    z = pose[..., :3, 2]
    x = np.cos(q7)[..., None] * pose[..., :3, 0] - np.sin(q7)[..., None] * pose[..., :3, 1]
    wrist = pose[..., :3, 3] - FLANGE * z - A7 * x - np.array([0.0, 0.0, D1])
    return q7, x, z, wrist


def _elbow(wrist: Array) -> tuple[Array, Array, Array]:
    """Return q4, and S in the x-y plane of the forearm frame, from W - S (..., 3)."""
    cosine = (_UPPER_ARM**2 + _FOREARM**2 - _dot(wrist, wrist)) / (2 * _UPPER_ARM * _FOREARM)
    q4 = np.arccos(np.where(np.abs(cosine) <= 1.0, cosine, np.nan)) + _BEND - 2 * np.pi
    sin4, cos4 = np.sin(q4), np.cos(q4)
    return q4, -A4 * cos4 - D3 * sin4, A4 * sin4 - D3 * cos4


def _wrist_bend(x: Array, z: Array, wrist: Array, along_forearm: Array) -> Array:
    """Return both q6 (..., 2) that give S - W the component ``along_forearm`` on the forearm, sin q6 x - cos q6 z."""
    a, b = -_dot(x, wrist), _dot(z, wrist)
    cosine = along_forearm / np.hypot(a, b)
    half = np.arccos(np.where(np.abs(cosine) <= 1.0, cosine, np.nan))
    middle = np.arctan2(a, b)
    return np.stack([middle + half, middle - half], axis=-1)


def _shoulder(x4: Array, y4: Array, z4: Array, q4: Array) -> tuple[Array, Array, Array]:
    """Return both (q1, q2, q3), each (..., 2, 2), from the forearm frame (..., 2, 3)."""
    sin4, cos4 = np.sin(q4)[..., None], np.cos(q4)[..., None]
    x3, z3 = cos4 * x4 - sin4 * y4, sin4 * x4 + cos4 * y4
    up = np.arctan2(np.hypot(z3[..., 0], z3[..., 1]), z3[..., 2])
    turn = np.arctan2(z3[..., 1], z3[..., 0])
    q1 = np.stack([turn, np.where(turn > 0, turn - np.pi, turn + np.pi)], axis=-1)
    q2 = np.stack([up, -up], axis=-1)
    sin1, cos1, zero = np.sin(q1), np.cos(q1), np.zeros_like(q1)
    x2 = np.stack([cos1 * np.cos(q2), sin1 * np.cos(q2), -np.sin(q2)], axis=-1)
    y2 = np.stack([-sin1, cos1, zero], axis=-1)
    x3 = x3[..., None, :]
    return q1, q2, np.arctan2(_dot(y2, x3), _dot(x2, x3))


def manipulability(q_rad: JointSamples) -> Array:
    """Return Yoshikawa's measure ``sqrt(det(J Jt))`` (n,) of the flange; 0 = singular. The tcp's is the same."""
    base_from_joint, flange_m = _chain(q_rad)
    axes, origins = base_from_joint[..., :3, 2], base_from_joint[..., :3, 3]
    jacobian = np.concatenate([np.cross(axes, flange_m[:, None] - origins), axes], axis=-1)
    return np.asarray(np.sqrt(np.maximum(0.0, np.linalg.det(jacobian.swapaxes(-1, -2) @ jacobian))))


def _chain(q_rad: JointSamples) -> tuple[Array, Array]:
    """Return poses (n, 7, 4, 4) of the joint frames and positions (n, 3) of the flange."""
    pose = np.broadcast_to(np.eye(4), (len(q_rad), 4, 4))
    frames = []
    for (a_m, alpha_rad, d_m), q in zip(_DH, q_rad.T, strict=True):
        cos, sin, zero, one = np.cos(q), np.sin(q), np.zeros_like(q), np.ones_like(q)
        ca, sa = np.cos(alpha_rad), np.sin(alpha_rad)
        step = np.array([
            [cos, -sin, zero, a_m * one],
            [ca * sin, ca * cos, -sa * one, -sa * d_m * one],
            [sa * sin, sa * cos, ca * one, ca * d_m * one],
            [zero, zero, zero, one],
        ])  # fmt: skip
        pose = pose @ step.transpose(2, 0, 1)
        frames.append(pose)
    return np.stack(frames, axis=1), pose[:, :3, 3] + FLANGE * pose[:, :3, 2]
