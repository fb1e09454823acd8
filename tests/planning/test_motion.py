"""One motion: its way, and the two judgements it must pass."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from config.limits import UPPER_RAD, check
from planning.blend import blended
from planning.infeasible import Infeasible
from planning.motion import connect, motion, move
from planning.robot import Robot
from planning.scene import Scene
from planning.search import search
from planning.world import Collision
from tests.planning.conftest import CAPTURE, WIDE_M, among, box

ACROSS = CAPTURE + np.array([2.0, 0, 0, 0, 0, 0, 0])
BLOCK = box("block", (0.15, 0.35, 0.55), (0.05, 0.05, 0.3))
AROUND_HAND = box("block", (0.375, 0.0, 0.6), (0.3, 0.3, 0.1))


def test_a_free_move_is_a_straight_joint_line(scene: Scene) -> None:
    q = move(scene, CAPTURE, ACROSS).filtered()
    along = (q - CAPTURE) @ (ACROSS - CAPTURE) / ((ACROSS - CAPTURE) @ (ACROSS - CAPTURE))
    assert np.abs(q - CAPTURE - along[:, None] * (ACROSS - CAPTURE)).max() < 1e-9
    assert check(q).ok


def test_a_blocked_move_goes_around(robot: Robot) -> None:
    crowded = among(robot, BLOCK)
    trajectory = move(crowded, CAPTURE, ACROSS)
    assert np.array_equal(trajectory.end_q_rad, ACROSS)
    assert check(trajectory.filtered()).ok
    assert crowded.first_collision(trajectory.filtered()[::5], WIDE_M) is None
    assert crowded.gate(trajectory.filtered(), WIDE_M) is None


def test_where_no_way_is_found_the_obstacle_is_named(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planning.motion.search", lambda *_: None)
    with pytest.raises(CycleFailure, match=r"no way around: .* touches block") as caught:
        move(among(robot, BLOCK), CAPTURE, ACROSS)
    assert caught.value.failure is Code.COLLISION


@pytest.mark.parametrize(("start", "goal", "which"), [(CAPTURE, ACROSS, "start"), (ACROSS, CAPTURE, "end")])
def test_a_move_from_or_to_a_collision_is_refused(
    robot: Robot, start: np.ndarray, goal: np.ndarray, which: str
) -> None:
    with pytest.raises(CycleFailure, match=rf"cannot {which} .* touches block") as caught:
        move(among(robot, AROUND_HAND), start, goal)
    assert caught.value.failure is Code.COLLISION


@pytest.mark.parametrize("bad", [CAPTURE * np.nan, CAPTURE + np.array([0, 0, 0, 0, 0, UPPER_RAD[5], 0])])
def test_a_goal_that_is_no_place_to_be_is_refused(scene: Scene, bad: np.ndarray) -> None:
    with pytest.raises(CycleFailure) as caught:
        move(scene, CAPTURE, bad)
    assert caught.value.failure is Code.MOTION_REFUSED


def test_what_the_planner_overlooks_the_gate_refuses(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    crowded = among(robot, BLOCK)
    monkeypatch.setattr(Scene, "first_collision", lambda *_: None)
    way = connect(crowded, CAPTURE, [ACROSS], WIDE_M)
    with pytest.raises(Infeasible, match=r"home: .* touches block"):
        motion("home", way, way.lines(), crowded, WIDE_M)


def test_the_nearest_goal_that_a_straight_line_reaches_is_taken(robot: Robot) -> None:
    behind, beside = ACROSS, CAPTURE + np.array([-0.5, 0, 0, 0, 0, 0, 0])
    way = connect(among(robot, BLOCK), CAPTURE, [behind, beside], WIDE_M)
    assert (way.goal, way.route) == (1, "straight")


def test_a_way_that_no_configuration_may_take_is_given_up(robot: Robot) -> None:
    """However little such a refusal costs: it makes no check for collisions."""
    with pytest.raises(Infeasible, match="no way around"):
        connect(among(robot, BLOCK), CAPTURE, [ACROSS], WIDE_M, lambda q: bool(q[0] < 0.01))


def test_every_line_of_a_searched_way_is_free_and_its_corners_can_be_rounded(robot: Robot) -> None:
    crowded = among(robot, BLOCK)
    way = connect(crowded, CAPTURE, [ACROSS], WIDE_M)
    assert way.route == "searched"
    assert all(crowded.is_line_free(line[0], line[1], WIDE_M) for line in way.lines())
    bends = blended(way.lines(), 0.02)
    assert all(crowded.first_collision(bends.points_rad[begin : end + 1], WIDE_M) is None for begin, end in bends.bends)


def test_the_same_question_has_the_same_way_to_the_last_bit(robot: Robot) -> None:
    one, other = (connect(among(robot, BLOCK), CAPTURE, [ACROSS], WIDE_M).points_rad for _ in range(2))
    assert np.array_equal(one, other)


def test_a_way_whose_corners_touch_is_searched_anew(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first path's only corner is just beside the block: there the lines are free, but no rounded corner is."""
    crowded, seeds = among(robot, BLOCK), []
    judged = iter([Collision("hand", "block", by_hand=True)])

    def searched(*args: Any) -> np.ndarray | None:
        seeds.append(args[4])
        return search(*args)

    monkeypatch.setattr("planning.motion.search", searched)
    monkeypatch.setattr("planning.motion._bends_touch", lambda *_: next(judged, None))
    assert connect(crowded, CAPTURE, [ACROSS], WIDE_M).route == "searched"
    assert seeds == [0, 1]
