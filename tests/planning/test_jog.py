"""A step by hand: straight, slow, never into a known box, and out of one where every distance grows."""

from __future__ import annotations

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from config.limits import check
from config.load import load_station
from planning.distances import distances
from planning.jog import jog
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot
from planning.scene import Scene

STATION = load_station(None, [])
HOME = np.asarray(STATION.arm.capture_q_rad)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.of(Robot(STATION), STATION)


def _above_the_table(scene: Scene, height_m: float) -> np.ndarray:
    """The joints (7,) with the tcp at a height, straight below the capture pose."""
    pose = scene.robot.base_from_tcp(HOME)
    line = tcp_line(FR3_ARM, HOME, pose, np.array([0, 0, height_m - pose[2, 3]]))
    assert line is not None
    return np.asarray(line[-1])


@pytest.mark.parametrize("shift", [[0.005, 0, 0], [0, -0.005, 0], [0, 0, 0.005]])
def test_a_step_is_straight_within_the_limits_and_never_faster(scene: Scene, shift: list[float]) -> None:
    commands = jog(scene, HOME, 0.08, np.array(shift), 0.025).filtered()
    poses = np.array([scene.robot.base_from_tcp(q) for q in commands])
    moved = poses[:, :3, 3] - poses[0, :3, 3]
    assert np.allclose(moved[-1], shift, atol=1e-5) and np.abs(np.cross(moved, shift)).max() < 1e-7
    assert np.allclose(poses[:, :3, :3], poses[0, :3, :3], atol=1e-5), "it does not turn"
    assert np.linalg.norm(np.diff(moved, axis=0), axis=1).max() / 1e-3 < 0.0251
    assert check(commands).ok


def test_a_step_into_the_table_is_refused_and_says_what_would_touch(scene: Scene) -> None:
    low = _above_the_table(scene, 0.014)
    with pytest.raises(CycleFailure, match="finger touches table") as refused:
        jog(scene, low, 0.08, np.array([0, 0, -0.01]), 0.025)
    assert refused.value.failure is Code.COLLISION


def test_from_what_is_touched_the_arm_comes_away_and_goes_nowhere_else(scene: Scene) -> None:
    inside = _above_the_table(scene, 0.002)
    names, before = distances(scene.robot, inside[None], 0.08)
    touched = [names[i] for i in np.flatnonzero(before[0] < 0)]
    assert touched and {box for _, box in touched} == {"table"}
    up = jog(scene, inside, 0.08, np.array([0, 0, 0.005]), 0.025)
    _, after = distances(scene.robot, up.filtered()[-1:], 0.08)
    assert after.min() == pytest.approx(before.min() + 0.005, abs=1e-4)
    for shift in ([0, 0, -0.005], [0.005, 0, 0]):
        with pytest.raises(CycleFailure, match="would not come away") as refused:
            jog(scene, inside, 0.08, np.array(shift), 0.025)
        assert refused.value.failure is Code.COLLISION


def test_beyond_the_reach_there_is_no_step(scene: Scene) -> None:
    with pytest.raises(CycleFailure) as refused:
        jog(scene, HOME, 0.08, np.array([2.0, 0, 0]), 0.025)
    assert refused.value.failure is Code.UNREACHABLE
