"""The simulated arm stops itself when it runs into something, and says so until it is recovered."""

from __future__ import annotations

import numpy as np
import pytest

from bus.errors import ArmReflex, MotionRefused
from bus.messages import ArmMode
from config.load import load_station
from drivers.node.guard import Guard
from drivers.node.registry import open_devices
from planning.blend import blended
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot
from planning.timing import rest_to_rest, timed


def test_driving_the_hand_into_the_table_is_a_reflex_until_recovered() -> None:
    station = load_station()
    devices = open_devices("sim", station)
    assert devices.arm is not None
    arm, robot = Guard(devices.arm, station), Robot(station)
    arm.connect()
    q_rad = np.array(station.arm.capture_q_rad)
    pose = robot.base_from_tcp(q_rad)
    into_the_table = tcp_line(FR3_ARM, q_rad, pose, np.array([0.0, 0.0, -pose[2, 3] - 0.06]))
    assert into_the_table is not None
    with pytest.raises(ArmReflex, match="touched something"):
        arm.execute(timed(station, blended([into_the_table])))
    state = arm.state()
    assert state.mode is ArmMode.REFLEX
    assert robot.base_from_tcp(state.q_rad)[2, 3] < 0.05 and np.abs(state.dq_rad_s).max() < 0.05
    with pytest.raises(MotionRefused, match="reflex"):
        arm.execute(rest_to_rest(station, state.q_rad, state.q_rad + 0.01))
    arm.recover()
    assert arm.state().mode is ArmMode.IDLE
