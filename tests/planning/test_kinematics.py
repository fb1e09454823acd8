"""Closed-form inverse kinematics, and what makes one solution better than another."""

from __future__ import annotations

import numpy as np
import pytest

from config.limits import FR3, LOWER_RAD, UPPER_RAD
from planning.arm import cost, limit_distance_rad, rest_to_rest_s
from planning.kinematics import FR3_ARM, branches, inverse, manipulability, q7_grid
from planning.robot import Robot

STRETCHED_Q4 = -0.47


def random_q(count: int) -> np.ndarray:
    q = np.random.default_rng(4).uniform(LOWER_RAD, UPPER_RAD, (count, 7))
    q[:, 3] = np.minimum(q[:, 3], STRETCHED_Q4 - 0.01)
    return q


def test_the_configuration_that_made_a_pose_is_among_its_solutions(robot: Robot) -> None:
    for q in random_q(300):
        solutions = inverse(robot.base_from_flange(q), q[6:])
        assert np.abs(solutions - q).max(axis=1).min() < 1e-6


def test_every_solution_reaches_the_pose_inside_the_limits(robot: Robot) -> None:
    found = 0
    for q in random_q(50):
        pose = robot.base_from_flange(q)
        for solution in inverse(pose, q7_grid(15)):
            found += 1
            assert np.abs(robot.base_from_flange(solution) - pose).max() < 1e-9
            assert ((solution >= LOWER_RAD) & (solution <= UPPER_RAD)).all()
    assert found > 500


def test_a_pose_out_of_reach_has_no_solution() -> None:
    far = np.eye(4)
    far[:3, 3] = [1.5, 0.0, 0.5]
    assert inverse(far, q7_grid()).shape == (0, 7)


def test_poses_and_q7_broadcast(robot: Robot) -> None:
    q = random_q(5)
    poses = np.stack([robot.base_from_flange(each) for each in q])
    together = branches(poses, q[:, 6])
    assert together.shape == (5, 4, 7)
    for pose, each, expected in zip(poses, q, together, strict=True):
        assert np.array_equal(branches(pose, each[6:])[0], expected, equal_nan=True)


def test_rest_to_rest_time_is_that_of_a_trapezoid() -> None:
    slow, fast = np.zeros(7), np.zeros(7)
    slow[0], fast[0] = 0.1, 2.0
    a, v = 9.999, 2.619
    assert rest_to_rest_s(FR3, np.zeros(7), slow) == pytest.approx(2 * np.sqrt(0.1 / a))
    assert rest_to_rest_s(FR3, np.zeros(7), fast) == pytest.approx(2.0 / v + v / a, rel=1e-3)


def test_nearness_of_a_limit_and_of_a_singularity_cost() -> None:
    q = np.array([0.0, -0.45, 0.0, -1.83, 0.0, 1.38, 0.785])
    at_limit = q.copy()
    at_limit[1] = UPPER_RAD[1]
    assert limit_distance_rad(FR3, at_limit) == 0.0
    assert manipulability(q[None])[0] > 0.06
    assert cost(FR3_ARM, q, q[None])[0] == 0.0
    assert cost(FR3_ARM, at_limit, at_limit[None])[0] == pytest.approx(0.3)
    stretched = np.array([0.0, 0.0, 0.0, UPPER_RAD[3], 0.0, 1.87, 0.0])
    assert manipulability(stretched[None])[0] < 0.06
    assert cost(FR3_ARM, stretched, stretched[None])[0] > 0.3


def test_manipulability_is_that_of_pinocchios_jacobian(robot: Robot) -> None:
    q = random_q(200)
    jacobians = np.stack([robot.jacobian(each) for each in q])
    expected = np.sqrt(np.maximum(0.0, np.linalg.det(jacobians @ jacobians.swapaxes(1, 2))))
    assert np.abs(manipulability(q) - expected).max() < 1e-12
