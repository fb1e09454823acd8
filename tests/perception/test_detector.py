"""VLAD-Grasp on the simulated camera's frames, judged by where the objects really are."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from bus.codes import Code
from bus.commands import PresentRequest
from bus.errors import CycleFailure
from bus.messages import Detections, ModelReply, Observation
from cell.pick.capture import capture
from config.load import load_station
from config.schema import Station
from drivers.node.registry import open_devices
from logs.differences import compare
from perception.detector import detect as detect_with
from perception.detector import ignore_reply
from perception.models import open_models
from perception.scene.change import cleared_fraction
from planning.robot import Robot

See = Callable[[str, int], tuple[Observation, np.ndarray]]
STATION = load_station(None, ["sim.seed=5"])


def detect(observation: Observation, station: Station) -> Detections:
    return detect_with(observation, station, open_models(station, {}), ignore_reply)


@pytest.fixture(scope="module")
def see() -> Iterator[See]:
    """(name, seed) -> what the camera sees, and the object's true pose in ``base``."""
    devices = open_devices("sim", STATION)
    camera, arm, presenter = devices.camera, devices.arm, devices.presenter
    assert camera is not None and arm is not None and presenter is not None
    camera.connect()
    arm.connect()
    robot = Robot(STATION)
    seen: dict[tuple[str, int], tuple[Observation, np.ndarray]] = {}

    def look(name: str, seed: int) -> tuple[Observation, np.ndarray]:
        if (name, seed) not in seen:
            truth = presenter.present(PresentRequest(object=name, cycle=0, seed=seed))
            seen[name, seed] = capture(camera, arm, robot), truth.base_from_object
        return seen[name, seed]

    yield look
    camera.close()


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    ("name", "across_axis", "width_m"),
    [("bottle", 0, 0.060), ("controller", 0, 0.036), ("drone", 0, 0.044), ("spatula", 0, 0.020)],
)
def test_long_objects_are_taken_across(see: See, name: str, across_axis: int, width_m: float, seed: int) -> None:
    """The closing axis crosses the object's long axis, near its line, and the width is the object's."""
    observation, base_from_object = see(name, seed)
    best = detect(observation, STATION).grasps[0]
    long_axis = base_from_object[:3, across_axis]
    closing = best.base_from_tcp[:3, 1]
    assert abs(np.degrees(np.arcsin(np.clip(closing @ long_axis, -1, 1)))) < 12
    offset = best.base_from_tcp[:2, 3] - base_from_object[:2, 3]
    assert abs(offset @ closing[:2]) < 0.006
    assert best.width_m == pytest.approx(width_m, abs=0.006)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_a_cup_is_taken_across_its_middle_or_by_its_wall(see: See, seed: int) -> None:
    observation, base_from_object = see("cup", seed)
    best = detect(observation, STATION).grasps[0]
    center_m = np.linalg.norm(best.base_from_tcp[:2, 3] - base_from_object[:2, 3])
    across = best.width_m == pytest.approx(0.066, abs=0.008) and center_m < 0.008
    wall = best.width_m < 0.015 and center_m == pytest.approx(0.031, abs=0.008)
    assert across or wall


@pytest.mark.parametrize("name", ["bottle", "controller", "cup", "drone", "spatula"])
def test_every_grasp_is_a_pose_from_above_with_its_tips_over_the_table(see: See, name: str) -> None:
    for grasp in detect(see(name, 1)[0], STATION).grasps:
        rotation = grasp.base_from_tcp[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1) and rotation[2, 2] == pytest.approx(-1)
        assert grasp.base_from_tcp[2, 3] >= 0.012
        assert grasp.width_m < grasp.opening_m <= STATION.hand.max_width_m


def test_grasps_are_ranked(see: See) -> None:
    scores = [grasp.score for grasp in detect(see("drone", 1)[0], STATION).grasps]
    assert scores == sorted(scores, reverse=True) and len(scores) >= 2


def test_the_same_observation_gives_the_same_bits(see: See) -> None:
    observation, _ = see("cup", 1)
    assert compare(detect(observation, STATION), detect(observation, STATION), {}) == []


def test_compliance_widens_the_rectangles_and_not_the_object(see: See) -> None:
    observation, _ = see("bottle", 1)
    soft = load_station(None, ["sim.seed=5", "perception.compliance=1.5"])
    plain, wide = detect(observation, STATION), detect(observation, soft)
    assert wide.rectangles[0].width_px == pytest.approx(1.5 * plain.rectangles[0].width_px)
    assert [g.width_m for g in wide.grasps] == [g.width_m for g in plain.grasps]


def test_the_rectangle_lies_on_the_object(see: See) -> None:
    found = detect(see("spatula", 1)[0], STATION)
    u, v = found.rectangles[0].center_px
    assert found.evidence.object_mask[round(v), round(u)]


def test_the_evidence_shows_the_rod_and_keeps_what_was_said(see: See) -> None:
    replies: list[ModelReply] = []
    evidence = detect_with(see("bottle", 1)[0], STATION, open_models(STATION, {}), replies.append).evidence
    assert evidence.goal_rod_mask.sum() > 300
    assert not (evidence.goal_rod_mask & evidence.goal_object_mask).any()
    changed = (evidence.goal_image != evidence.color).any(axis=-1)
    assert (evidence.goal_rod_mask & ~changed).sum() == 0, "the rod is found only where it was painted"
    assert [reply.step for reply in replies] == ["reason", "direct", "render"]
    assert evidence.alignment.scale == pytest.approx(1.0, abs=0.05)


def _elsewhere(region: str) -> Station:
    return load_station(None, ["sim.seed=5", f"scene.pick_region_m={region}"])


def test_an_empty_region_is_no_object(see: See) -> None:
    observation, base_from_object = see("spatula", 1)
    y = base_from_object[1, 3]
    empty = _elsewhere("[0.32, 0.6, -0.22, -0.16]" if y > 0 else "[0.32, 0.6, 0.16, 0.22]")
    with pytest.raises(CycleFailure) as failure:
        detect(observation, empty)
    assert failure.value.failure is Code.NO_OBJECT


def test_a_jaw_too_small_is_no_grasp(see: See) -> None:
    observation, _ = see("bottle", 1)
    with pytest.raises(CycleFailure) as failure:
        detect(observation, load_station(None, ["hand.max_width_m=0.02"]))
    assert failure.value.failure is Code.NO_GRASP


def test_a_camera_without_depth_sees_no_table(see: See) -> None:
    observation, _ = see("bottle", 1)
    blind = observation.frame.model_copy(update={"depth_m": np.full_like(observation.frame.depth_m, np.nan)})
    with pytest.raises(CycleFailure) as failure:
        detect(observation.model_copy(update={"frame": blind}), STATION)
    assert failure.value.failure is Code.NO_TABLE


def test_the_place_is_cleared_only_when_the_object_left(see: See) -> None:
    there, _ = see("spatula", 1)
    gone, _ = see("cup", 2)
    found: Detections = detect(there, STATION)
    still, left = (cleared_fraction(found, 1, there, after, STATION) for after in (there, gone))
    assert still is not None and still < 0.3
    assert left is not None and left > 0.6
