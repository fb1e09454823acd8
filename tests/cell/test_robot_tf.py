"""Every link of the arm has its transform, under the name that the recorded URDF gives it."""

from __future__ import annotations

import queue
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from bus import topics
from bus.messages import ArmMode, ArmState, HandState
from bus.sensor_codec import arm_state_to_wire
from bus.session import Bus
from bus.threads import handled_by
from cell.daemon.robot_tf import RobotTf
from cell.daemon.runinfo import robot_description
from config.load import load_station
from planning.links import Links
from planning.robot import Robot
from tests.listeners import await_listeners

HOME = np.array([0.0, -0.45, 0.0, -1.83, 0.0, 1.38, 0.785])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(load_station())


def test_the_links_are_those_of_the_recorded_urdf_and_lead_to_hand_and_camera(robot: Robot) -> None:
    tree = ET.fromstring(robot_description(load_station()))
    joints = {
        (joint.find("parent").get("link"), joint.find("child").get("link"))  # type: ignore[union-attr]
        for joint in tree.iter("joint")
    }
    poses = Links(robot).at(HOME, 0.04)
    assert set(poses) - joints == {("fr3_hand", "camera")}
    assert {child for _, child in joints} - {child for _, child in poses} == {
        name for link in tree.iter("link") if "accelerometer" in (name := str(link.get("name")))
    }
    parents, base_from_camera, name = {child: parent for parent, child in poses}, np.eye(4), "camera"
    while name != "base":
        base_from_camera = poses[parents[name], name] @ base_from_camera
        name = parents[name]
    assert np.allclose(base_from_camera, robot.base_from_color(HOME), atol=1e-12)
    apart_m = poses["fr3_hand", "fr3_leftfinger"][1, 3] - poses["fr3_hand", "fr3_rightfinger"][1, 3]
    assert apart_m == pytest.approx(0.04)


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    with Bus.listen("sim", endpoint) as bus:
        yield bus


def _arm(stamp_ns: int, q_rad: Any) -> bytes:
    still = np.zeros(7)
    return arm_state_to_wire(
        ArmState(stamp_ns=stamp_ns, mode=ArmMode.IDLE, q_rad=q_rad, dq_rad_s=still, tau_ext_nm=still)
    )


def test_the_newest_states_are_said_as_transforms_with_the_arms_stamp(bus: Bus, endpoint: str, robot: Robot) -> None:
    said: queue.Queue[bytes] = queue.Queue()
    defects: list[BaseException] = []
    bus.subscribe("tf", lambda heard: said.put(heard.payload), own=True)
    with (
        handled_by(lambda _name, defect: defects.append(defect)),
        closing(RobotTf(bus, robot, lambda heard: True)) as tf,
        Bus.join("sim", endpoint) as node,
    ):
        await_listeners(node, topics.ARM_STATE, topics.HAND_STATE)
        node.publish(topics.HAND_STATE, HandState(stamp_ns=1, width_m=0.02, is_moving=False, is_homed=True))
        give_up_s = time.monotonic() + 60
        while not tf._hand:  # what is published on another key afterwards may be heard before
            assert time.monotonic() < give_up_s
            time.sleep(0.002)
        for payload in (b"nonsense", _arm(1, np.full(7, np.nan)), _arm(2, HOME), _arm(3, HOME + 0.1)):
            node.publish(topics.ARM_STATE, payload)
        while (placed := topics.TF.says.FromString(said.get(timeout=60))).transforms[0].timestamp.nanos < 3:
            pass
    assert not defects
    expected = Links(robot).at(HOME + 0.1, 0.02)
    assert [(one.parent_frame_id, one.child_frame_id) for one in placed.transforms] == list(expected)
    for one, pose in zip(placed.transforms, expected.values(), strict=True):
        assert np.allclose([one.translation.x, one.translation.y, one.translation.z], pose[:3, 3], atol=1e-12)


def test_an_arm_at_rest_is_not_said_over_and_over(bus: Bus, endpoint: str, robot: Robot) -> None:
    said: list[bytes] = []
    bus.subscribe("tf", lambda heard: said.append(heard.payload), own=True)
    moved: queue.Queue[bytes] = queue.Queue()
    bus.subscribe("tf", lambda heard: moved.put(heard.payload), own=True)
    with closing(RobotTf(bus, robot, lambda heard: True)), Bus.join("sim", endpoint) as node:
        await_listeners(node, topics.ARM_STATE)
        for stamp in range(1, 400):
            node.publish(topics.ARM_STATE, _arm(stamp, HOME))
        node.publish(topics.ARM_STATE, _arm(500, HOME + 0.1))
        while topics.TF.says.FromString(moved.get(timeout=60)).transforms[0].timestamp.nanos != 500:
            pass
    assert len(said) <= 4
