"""Ways to grasp: turned about the rod, best first, and none that cannot be."""

from __future__ import annotations

import numpy as np
import pytest

from bus.codes import Code
from bus.messages import Grasp
from config.limits import FR3, UPPER_RAD
from config.pick import PlanningSettings
from config.schema import Station
from planning.arm import limit_distance_rad
from planning.candidates import Approach, approaches, configurations, grasp_pose, twins
from planning.infeasible import Infeasible
from planning.kinematics import FR3_ARM
from planning.robot import Robot
from planning.search import LIMIT_MARGIN_RAD
from tests.planning.conftest import CAPTURE, NODES, STATION


def grasp(z_m: float = 0.05, score: float = 1.0, width_m: float = 0.04) -> Grasp:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 0.45, 0.05, z_m
    return Grasp(base_from_tcp=pose, width_m=width_m, opening_m=width_m + 0.02, score=score, rectangle=0,
                 imagined_base_from_tcp=pose, terms={})  # fmt: skip


def test_the_best_score_comes_first_and_a_tilt_costs() -> None:
    ordered = approaches([grasp(score=0.9), grasp(score=0.85)], STATION)
    assert [(one.index, round(np.degrees(one.tilt_rad))) for one in ordered[:4]] == [(0, 0), (0, 15), (0, -15), (1, 0)]
    assert len(ordered) == 2 * len(STATION.planning.tilts_deg)


def test_no_more_are_tried_than_configured() -> None:
    few = Station(nodes=NODES, planning=PlanningSettings(max_approaches=24))
    assert len(approaches([grasp()] * 12, few)) == 24
    assert len(approaches([grasp()] * 12, STATION)) == 12 * len(STATION.planning.tilts_deg)


@pytest.mark.parametrize("tilt_deg", [-30.0, 15.0, 45.0])
def test_a_tilt_turns_about_the_rod_and_keeps_the_tcp(tilt_deg: float) -> None:
    high = grasp(z_m=0.10)
    pose = grasp_pose(Approach(0, high, np.radians(tilt_deg)), STATION)
    assert np.allclose(pose[:3, 3], high.base_from_tcp[:3, 3])
    assert np.allclose(pose[:3, 1], high.base_from_tcp[:3, 1], atol=1e-12), "the closing axis"
    assert np.degrees(np.arccos(pose[:3, 2] @ high.base_from_tcp[:3, 2])) == pytest.approx(abs(tilt_deg))


def test_a_jaw_too_narrow_is_a_reason() -> None:
    with pytest.raises(Infeasible, match="width: 90 mm are wider than the jaw opens") as caught:
        grasp_pose(Approach(0, grasp(width_m=0.09), 0.0), STATION)
    assert caught.value.code is Code.NO_GRASP


def test_a_score_that_is_no_number_is_a_reason() -> None:
    with pytest.raises(Infeasible, match="finite"):
        grasp_pose(Approach(0, grasp(score=float("nan")), 0.0), STATION)


def test_configurations_reach_the_pose_off_the_limits_the_nearest_first(robot: Robot) -> None:
    poses = twins(grasp().base_from_tcp)
    found = list(configurations(FR3_ARM, poses, CAPTURE))
    assert len(found) > 20
    for q, pose in found:
        assert np.abs(robot.base_from_tcp(q) - pose).max() < 1e-9
        assert limit_distance_rad(FR3, q) >= LIMIT_MARGIN_RAD
    assert np.abs(found[0][0] - CAPTURE).max() < np.abs(found[-1][0] - CAPTURE).max()
    assert (found[0][0] < UPPER_RAD).all()


def test_a_pose_out_of_reach_has_none() -> None:
    far = np.diag([1.0, -1.0, -1.0, 1.0])
    far[:3, 3] = 1.4, 0.0, 0.3
    assert list(configurations(FR3_ARM, [far], CAPTURE)) == []
