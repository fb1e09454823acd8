"""`benchmarks planning --problems`: what it reads of an archive, which problems are this arm's, and what it counts."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

import coal
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import moves
from benchmarks.__main__ import app
from benchmarks.motionbench import problems
from config.limits import UPPER_RAD
from planning.robot import Robot

pytest.importorskip("yaml", reason="PyYAML is not installed: just setup")

READY = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
ASIDE = (0.8, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
BEYOND = (0.0, -0.785, 0.0, -2.356, float(UPPER_RAD[4]) + 0.01, 1.571, 0.785)
NO_SPEED = (float(UPPER_RAD[0]) - 1e-4, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)

_SCENE = """
world:
  collision_objects:
    - id: post
      primitives:
        - {type: cylinder, dimensions: [0.9, 0.03]}
      primitive_poses:
        - position: [0.40, 0.20, 0.45]
          orientation: [0, 0, 0, 1]
    - id: wall
      primitive_poses:
        - {position: [0.0, -0.9, 0.5], orientation: [0, 0, 0.70710678, 0.70710678]}
      primitives:
        - {type: box, dimensions: [0.04, 1.0, 1.0]}
"""


def request(goal: tuple[float, ...]) -> str:
    names = [f"panda_joint{number}" for number in range(1, 8)]
    to = [{"joint_name": name, "position": position} for name, position in zip(names, goal, strict=True)]
    start = {"joint_state": {"name": names, "position": READY}}
    return json.dumps({"start_state": start, "goal_constraints": [{"joint_constraints": to}]})  # JSON is YAML


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    path = tmp_path / "problems.tar.bz2"
    with tarfile.open(path, "w:bz2") as file:
        for number, goal in enumerate((ASIDE, BEYOND, NO_SPEED)):
            for name, text in (("scene", _SCENE), ("request", request(goal))):
                member = tarfile.TarInfo(f"problems/posts_panda/{name}{number:04d}.yaml")
                member.size = len(text.encode())
                file.addfile(member, io.BytesIO(text.encode()))
    return path


def test_shapes_are_where_the_scene_says_and_the_ends_are_the_request_s(archive: Path) -> None:
    problem = next(problems(archive, 1, 0))
    post, wall = problem.obstacles
    assert problem.name == "posts_panda/0000"
    assert isinstance(post.shape, coal.Cylinder) and (post.shape.radius, 2 * post.shape.halfLength) == (0.03, 0.9)
    assert isinstance(wall.shape, coal.Box) and np.allclose(2 * np.array(wall.shape.halfSide), [0.04, 1.0, 1.0])
    assert np.allclose(wall.pose[:3, 0], [0, 1, 0], atol=1e-6) and np.allclose(wall.pose[:3, 3], [0.0, -0.9, 0.5])
    assert np.array_equal(problem.ends_rad, [READY, ASIDE])


def test_every_second_from_the_first_is_the_others_of_every_second_from_the_second(archive: Path) -> None:
    names = [[problem.name[-4:] for problem in problems(archive, 2, offset)] for offset in (0, 1)]
    assert names == [["0000", "0002"], ["0001"]]


def test_an_archive_without_a_scene_is_refused(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "half.tar", "w") as file:
        file.addfile(tarfile.TarInfo("posts_panda/request0000.yaml"))
    with pytest.raises(ValueError, match=r"request0000\.yaml, but not .*scene0000\.yaml"):
        next(problems(tmp_path / "half.tar", 1, 0))


def test_problems_are_this_arm_s_where_it_reaches_them_and_solvable_where_it_may_move(
    archive: Path, robot: Robot
) -> None:
    one, beyond, no_speed = problems(archive, 1, 0)
    assert [problem.is_within_limits() for problem in (one, beyond, no_speed)] == [True, False, True]
    assert [problem.may_move_at_ends() for problem in (one, no_speed)] == [True, False]
    assert one.is_free(one.scene(robot))


def test_solved_and_refused_are_counted_apart_beside_the_peer(archive: Path) -> None:
    figures = moves.run(archive, 1, [0], lambda line: None)["offsets"]["0"]
    assert (figures["problems"], figures["within_limits"], figures["usable"], figures["solvable"]) == (3, 2, 2, 1)
    assert (figures["solved"], figures["unsolved"], figures["refused"], figures["refused_otherwise"]) == (1, [], 1, [])
    assert (figures["limit_violations"], figures["collisions_independent"]) == (0, 0)
    assert figures["peer"]["solved"] == 1


def test_without_the_archive_it_says_so(tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["planning", "--problems", str(tmp_path / "none.tar.bz2"), "--json"])
    assert "There is no file" in json.loads(said.stdout)["skipped"]
