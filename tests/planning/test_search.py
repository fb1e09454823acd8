"""Ways around obstacles, the same ones every time."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from config.limits import FR3
from planning.robot import Robot
from planning.scene import Scene
from planning.search import search
from tests.planning.conftest import CAPTURE, WIDE_M, among, box

ACROSS = CAPTURE + np.array([1.2, 0, 0, 0, 0, 0, 0])
WALL = box("wall", (0.30, 0.25, 0.45), (0.4, 0.03, 0.3))

_ELSEWHERE = """
import json, numpy as np
from config.limits import FR3
from planning.search import search
a, b = np.zeros(7) + [0, 0, 0, -1.5, 0, 1.5, 0], np.array([1.0, 0.5, 0, -1.5, 0, 1.5, 0])
def free_line(one, other):
    return all(not (0.4 < q[0] < 0.6 and q[1] < 0.9) for q in np.linspace(one, other, 50))
print(json.dumps(search(FR3, free_line, a, [b], 3, lambda: 0).tolist()))
"""


def along(free: Callable[[np.ndarray], bool]) -> Callable[[np.ndarray, np.ndarray], bool]:
    """Whether a whole line is free, by checks of configurations 0.03 rad apart."""

    def free_line(one: np.ndarray, other: np.ndarray) -> bool:
        steps = int(np.ceil(np.linalg.norm(other - one) / 0.03))
        return all(free(q) for q in np.linspace(one, other, steps + 1))

    return free_line


def way_around(scene: Scene, seed: int) -> np.ndarray | None:
    return search(
        FR3, lambda one, other: scene.is_line_free(one, other, WIDE_M), CAPTURE, [ACROSS], seed, lambda: scene.checks
    )


def test_it_finds_a_way_around_a_wall(robot: Robot) -> None:
    scene = among(robot, WALL)
    assert "touches wall" in str(scene.first_collision(np.stack([CAPTURE, ACROSS]), WIDE_M))
    for seed in range(3):
        path = way_around(scene, seed)
        assert path is not None and np.allclose(path[[0, -1]], [CAPTURE, ACROSS])
        assert all(scene.is_line_free(one, other, WIDE_M) for one, other in pairwise(path))


def test_the_same_question_has_the_same_answer_whatever_was_asked_before(robot: Robot) -> None:
    scene = among(robot, WALL)
    first = way_around(scene, seed=1)
    way_around(scene, seed=2)
    again = way_around(scene, seed=1)
    assert first is not None and again is not None
    assert np.array_equal(first, again)


def test_another_process_gives_the_same_answer() -> None:
    answers = [
        json.loads(subprocess.run([sys.executable, "-c", _ELSEWHERE], capture_output=True, check=True).stdout)
        for _ in range(2)
    ]
    assert answers[0] == answers[1]


def test_where_there_is_no_way_it_gives_up_after_a_bounded_effort() -> None:
    asked = 0

    def walled_in(q: np.ndarray) -> bool:
        nonlocal asked
        asked += 1
        return bool(np.abs(q - CAPTURE).max() < 0.05 or np.abs(q - ACROSS).max() < 0.05)

    assert search(FR3, along(walled_in), CAPTURE, [ACROSS], 0, lambda: asked) is None
    assert asked < 30_000


@pytest.mark.parametrize(("start_free", "goal_free"), [(True, False), (False, True)])
def test_where_the_start_or_every_goal_is_not_free_nothing_is_searched(start_free: bool, goal_free: bool) -> None:
    """OMPL alone would wait for another goal, without a check and without end."""

    def free_line(one: np.ndarray, other: np.ndarray) -> bool:
        ends = {tuple(CAPTURE): start_free, tuple(ACROSS): goal_free}
        return ends.get(tuple(one), True) and ends.get(tuple(other), True)

    assert search(FR3, free_line, CAPTURE, [ACROSS], 0, lambda: 0) is None


def test_it_goes_to_whichever_goal_it_reaches() -> None:
    def only_the_second(q: np.ndarray) -> bool:
        return bool(q[0] < 0.5)

    near = CAPTURE + np.array([-0.5, 0, 0, 0, 0, 0, 0])
    path = search(FR3, along(only_the_second), CAPTURE, [ACROSS, near], 0, lambda: 0)
    assert path is not None
    assert np.allclose(path[-1], near)


def test_a_stop_ends_a_search_at_its_next_check(robot: Robot) -> None:
    """Counted in checks: of 20,000 that this search may make, a stop leaves at most a few."""
    scene, asked = among(robot, WALL), 0

    def free(q: np.ndarray) -> bool:
        nonlocal asked
        asked += 1
        if asked == 200:
            scene.cancel.set()
        return scene.collision(q, WIDE_M) is None

    with pytest.raises(CycleFailure) as failure:
        search(FR3, along(free), CAPTURE, [ACROSS], 0, lambda: asked)
    assert failure.value.failure is Code.STOPPED and asked == 200


def test_a_stop_ends_every_check_of_a_plan(robot: Robot) -> None:
    scene = among(robot, WALL)
    line = np.stack([CAPTURE, ACROSS])
    scene.empty().cancel.set()  # the same stop for all scenes of a plan
    check: Callable[[], object]
    for check in (
        lambda: scene.collision(CAPTURE, WIDE_M),
        lambda: scene.first_collision(line, WIDE_M),
        lambda: scene.is_line_free(line[0], line[1], WIDE_M),
        lambda: scene.gate(line, WIDE_M),
    ):
        with pytest.raises(CycleFailure, match="Stopped during 'plan'"):
            check()
