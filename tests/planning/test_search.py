"""Ways around obstacles, the same ones every time."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from planning.robot import Robot
from planning.scene import Scene
from planning.search import search
from tests.planning.conftest import CAPTURE, WIDE_M, among, box

ACROSS = CAPTURE + np.array([1.2, 0, 0, 0, 0, 0, 0])
WALL = box("wall", (0.30, 0.25, 0.45), (0.4, 0.03, 0.3))

_ELSEWHERE = """
import json, numpy as np
from planning.search import search
a, b = np.zeros(7) + [0, 0, 0, -1.5, 0, 1.5, 0], np.array([1.0, 0.5, 0, -1.5, 0, 1.5, 0])
print(json.dumps(search(lambda q: not (0.4 < q[0] < 0.6 and q[1] < 0.9), a, [b], seed=3).tolist()))
"""


def way_around(scene: Scene, seed: int) -> np.ndarray | None:
    return search(lambda q: scene.collision(q, WIDE_M) is None, CAPTURE, [ACROSS], seed)


def test_it_finds_a_way_around_a_wall(robot: Robot) -> None:
    scene = among(robot, WALL)
    assert "touches wall" in str(scene.first_collision(np.stack([CAPTURE, ACROSS]), WIDE_M))
    paths = [path for seed in range(3) if (path := way_around(scene, seed)) is not None]
    assert any(scene.first_collision(path, WIDE_M) is None for path in paths)
    assert all(np.allclose(path[[0, -1]], [CAPTURE, ACROSS]) for path in paths)


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

    assert search(walled_in, CAPTURE, [ACROSS], seed=0) is None
    assert asked < 30_000


@pytest.mark.parametrize("blocked", ["start", "every goal"])
def test_a_start_or_goals_that_are_not_free_are_no_way_at_once(blocked: str) -> None:
    """OMPL alone waits for a better goal for ever, and looks at no check meanwhile that could stop it."""
    start, goal = CAPTURE, ACROSS
    taken = start if blocked == "start" else goal
    assert search(lambda q: not np.allclose(q, taken), start, [goal], seed=0) is None


def test_it_goes_to_whichever_goal_it_reaches() -> None:
    def only_the_second(q: np.ndarray) -> bool:
        return bool(q[0] < 0.5)

    near = CAPTURE + np.array([-0.5, 0, 0, 0, 0, 0, 0])
    path = search(only_the_second, CAPTURE, [ACROSS, near], seed=0)
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
        search(free, CAPTURE, [ACROSS], seed=0)
    assert failure.value.failure is Code.STOPPED and asked == 200


def test_a_stop_ends_every_check_of_a_plan(robot: Robot) -> None:
    scene = among(robot, WALL)
    line = np.stack([CAPTURE, ACROSS])
    scene.empty().cancel.set()  # the same stop for all scenes of a plan
    check: Callable[[], object]
    for check in (
        lambda: scene.collision(CAPTURE, WIDE_M),
        lambda: scene.first_collision(line, WIDE_M),
        lambda: scene.gate(line, WIDE_M),
    ):
        with pytest.raises(CycleFailure, match="Stopped during 'plan'"):
            check()
