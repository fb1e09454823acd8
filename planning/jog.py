"""Small straight steps of the tcp by hand, among the known boxes: away from what is touched, never towards it. Pure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from bus.arrays import Joints, JointSamples, Vector3
from bus.codes import Code
from bus.errors import CycleFailure
from bus.trajectory import Trajectory
from planning.distances import distances
from planning.line import tcp_line
from planning.scene import Scene
from planning.timing import within_limits
from planning.world import Collision

Array = npt.NDArray[np.float64]

_PEAK = 1.875
"""Largest over mean speed of the minimum-jerk profile."""
_NEAR_M, _SAMPLES = 0.003, 13
"""Pairs nearer than this may only part; the step is looked at in so many places."""
_ROUNDING_M = 1e-6


def jog(scene: Scene, q_rad: Joints, width_m: float, shift_m: Vector3, speed_m_s: float) -> Trajectory:
    """Return a straight step of the tcp from rest to rest, without turning it.

    Where the arm is nearer than 3 mm to a known box, the step may lead away from it, with every distance growing.

    Args:
        q_rad: (joints,) where the arm rests. ``width_m``: measured opening of the hand.
        shift_m: (3,) in ``base``. ``speed_m_s``: the tcp is never faster.

    Raises:
        CycleFailure: COLLISION, naming the pair; UNREACHABLE; MOTION_REFUSED.
    """
    base_from_tcp = scene.robot.base_from_tcp(q_rad)
    line = tcp_line(scene.robot.arm, q_rad, base_from_tcp, shift_m)
    if line is None:
        raise CycleFailure(Code.UNREACHABLE, "The arm does not reach on in that direction: a limit, or its stretch.")
    path = CubicSpline(np.linspace(0.0, 1.0, len(line)), line)
    lasts_s = _PEAK * float(np.linalg.norm(shift_m)) / speed_m_s

    def sampler(times_s: Array) -> JointSamples:
        share = times_s / lasts_s
        return np.asarray(path(share**3 * (10 - 15 * share + 6 * share**2)))

    trajectory = within_limits(
        scene.robot.arm.limits, sampler, lasts_s, (line[0], line[-1]), scene.station.planning.window_ms
    )
    commands = trajectory.filtered()
    collision = scene.gate(commands, width_m)
    if collision is not None:
        _require_parting(scene, commands, width_m, collision)
    return trajectory


def _require_parting(scene: Scene, commands_rad: JointSamples, width_m: float, collision: Collision) -> None:
    """Raises: CycleFailure(COLLISION) unless every pair that is near parts, and no other comes near."""
    if scene.collision(commands_rad[0], width_m) is None:
        raise CycleFailure(Code.COLLISION, f"That would lead into something: {collision}.")
    rows = np.linspace(0, len(commands_rad) - 1, _SAMPLES).round().astype(int)
    names, apart_m = distances(scene.robot, commands_rad[rows], width_m)
    was_near = apart_m[0] < _NEAR_M
    if not was_near.any():  # it is a part of the robot itself, or a held thing
        raise CycleFailure(Code.COLLISION, f"The arm cannot be jogged from where it is: {collision}.")
    nearer = (np.diff(apart_m, axis=0) < -_ROUNDING_M) & (apart_m[1:] < _NEAR_M)
    stays = was_near & (apart_m[-1] <= apart_m[0] + _ROUNDING_M)
    wrong = nearer.any(axis=0) | stays
    if wrong.any():
        part, box = names[int(np.flatnonzero(wrong)[0])]
        raise CycleFailure(Code.COLLISION, f"{part} is at {box}, and would not come away from it: jog the other way.")
