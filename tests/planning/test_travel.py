"""How far the robot's points move along a joint line: the bound is never too small, and not much too large."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from config.limits import LOWER_RAD, UPPER_RAD
from planning.robot import HAND_FROM_TCP, Robot
from planning.travel import Travel, sweep_m
from planning.world import held_thing
from tests.planning.conftest import CAPTURE, WIDE_M, among, box
from tests.planning.test_scene import brute_force, edges, plate_in_the_way

_FINE = 150
_SOME = 12
FOLDED = CAPTURE + np.array([[0, 0, 0, 0, 0, 0, 0], [0, 0.5, 0, -0.6, 0, 0, 0]])
"""The elbow moves forward, and the hand back towards it."""


def lines(count: int, seed: int) -> list[np.ndarray]:
    """Joint lines (2, 7) anywhere within the range, of any length."""
    rng = np.random.default_rng(seed)
    starts = rng.uniform(LOWER_RAD, UPPER_RAD, (count, 7))
    ends = starts + rng.uniform(0.0, 1.0, (count, 1)) * (rng.uniform(LOWER_RAD, UPPER_RAD, (count, 7)) - starts)
    return list(np.stack([starts, ends], axis=1))


def vertices(robot: Robot, q_rad: np.ndarray) -> np.ndarray:
    """Some vertices (n, 3) of the convex hulls of all parts in ``base``; link 0, which stands still, is the first."""
    data, shapes = robot.model.createData(), pin.GeometryModel()
    hulls = [hull for hull in robot.hulls if hasattr(hull.geometry, "points")]
    for hull in hulls:
        shapes.addGeometryObject(hull)
    placed = shapes.createData()
    pin.updateGeometryPlacements(robot.model, data, shapes, placed, np.array([*q_rad, WIDE_M / 2, WIDE_M / 2]))
    points = [hull.geometry.points() for hull in hulls]
    return np.concatenate(
        [
            np.array(some)[:: len(some) // _SOME] @ pose.rotation.T + pose.translation
            for some, pose in zip(points, placed.oMg, strict=True)
        ]
    )


@pytest.mark.parametrize("line", [*lines(6, seed=1), FOLDED])
def test_nothing_moves_farther_or_nearer_than_the_bound_on_any_part_of_a_line(robot: Robot, line: np.ndarray) -> None:
    bound = Travel(robot, None).along(line[0], line[1])
    at = np.interp(np.linspace(0, 1, _FINE + 1), np.linspace(0, 1, len(bound)), bound)
    points = np.stack([vertices(robot, q) for q in np.linspace(line[0], line[1], _FINE + 1)])
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    for distances in (np.linalg.norm(np.diff(points, axis=0), axis=-1), np.abs(np.diff(apart, axis=0))):
        assert (distances.reshape(_FINE, -1).max(axis=1) <= np.diff(at) + 1e-9).all()


def test_the_bound_is_much_tighter_than_the_sum_of_all_levers(robot: Robot) -> None:
    travel = Travel(robot, None)
    shares = [travel.along(*line)[-1] / sweep_m(robot, line)[-1] for line in lines(100, seed=2)]
    assert np.median(shares) < 0.6


def test_what_is_held_moves_farther_than_the_hand(robot: Robot) -> None:
    """Half a metre beside the axis of joint 7, by 0.3 rad."""
    hand_from_held = HAND_FROM_TCP.copy()
    hand_from_held[0, 3] = 0.5
    held = held_thing(coal.Box(0.02, 0.02, 0.02), hand_from_held, "link 7")
    turned = CAPTURE + np.array([0, 0, 0, 0, 0, 0, 0.3])
    alone_m, holding_m = (Travel(robot, one).along(CAPTURE, turned)[-1] for one in (None, held))
    assert alone_m < 0.3 * 0.25 and 0.3 * 0.5 < holding_m < 0.3 * 0.65


def test_a_line_without_length_has_no_travel(robot: Robot) -> None:
    assert Travel(robot, None).along(CAPTURE, CAPTURE).tolist() == [0.0, 0.0]


def test_no_thin_plate_is_missed_on_a_line_that_is_called_free(robot: Robot) -> None:
    rng, hit = np.random.default_rng(7), 0
    for edge in edges(40, seed=8):
        crowded = among(robot, plate_in_the_way(robot, edge, rng))
        if brute_force(crowded, edge, step_m=0.002):
            hit += 1
            assert not crowded.is_line_free(edge[0], edge[1], WIDE_M)
    assert hit > 20


def test_a_line_is_free_where_a_denser_sweep_finds_nothing(robot: Robot) -> None:
    """They check other configurations, so they may differ where the clearance is just kept; hardly ever."""
    rng, same = np.random.default_rng(3), []
    for edge in edges(60, seed=4):
        crowded = among(robot, plate_in_the_way(robot, edge, rng))
        same.append(crowded.is_line_free(edge[0], edge[1], WIDE_M) == (crowded.first_collision(edge, WIDE_M) is None))
    assert sum(same) >= 58


def test_a_free_line_takes_few_checks(robot: Robot) -> None:
    scene = among(robot, box("far", (0.0, 1.5, 0.2), (0.1, 0.1, 0.1)))
    line = np.stack([CAPTURE, CAPTURE + np.array([0.6, 0, 0, 0, 0, 0, 0])])
    before = scene.checks
    assert scene.is_line_free(line[0], line[1], WIDE_M)
    free_line = scene.checks - before
    assert scene.first_collision(line, WIDE_M) is None
    assert free_line < scene.checks - before - free_line
