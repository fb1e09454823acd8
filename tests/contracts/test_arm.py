"""What every arm does."""

from __future__ import annotations

import numpy as np
import pytest

from bus.messages import ArmMode, Motion
from bus.trajectory import Trajectory
from config.franka_hand import FINGER_TIP_M
from config.load import load_station
from drivers.fr3.arm import Fr3Arm
from drivers.interface import Arm
from planning.blend import blended
from planning.feeling import guard, way_back
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot
from planning.slow_end import slow_end
from planning.timing import timed
from tests.contracts.conftest import EveryImplementation
from vlad_cell.testing import ArmSuite


class TestArm(EveryImplementation, ArmSuite):
    """The suite that other packages run on theirs; and the table, which no suite for a real arm drives it into."""

    @pytest.fixture(name="long_s")
    def given_long_s(self, arm: Arm) -> float:
        """Simulated time passes 20 times faster."""
        return 3.5 if isinstance(arm, Fr3Arm) else 20.0

    def test_a_guarded_motion_brakes_by_itself_where_it_meets_the_table(self, arm: Arm) -> None:
        if isinstance(arm, Fr3Arm):
            pytest.skip("its simulator tells no external torques; see test_fr3_loop")
        start_q_rad = arm.state().q_rad
        down = _into_the_table(start_q_rad)
        motion = arm.execute(down)
        assert (
            motion.contact_n is not None and motion.contact_n > load_station().execute.contact_n and not motion.finished
        )
        assert arm.state().mode is ArmMode.IDLE, "a reflex"
        assert arm.execute(down.model_copy(update={"raw_q_rad": _back(motion), "guard": None})).finished
        np.testing.assert_allclose(arm.state().q_rad, start_q_rad, atol=5e-3)


def _into_the_table(start_q_rad: np.ndarray) -> Trajectory:
    """Straight down until the finger tips are 3 mm in the table, slow at its end, and guarded."""
    station = load_station()
    robot, pose = Robot(station), Robot(station).base_from_tcp(start_q_rad)
    line = tcp_line(FR3_ARM, start_q_rad, pose, np.array([0.0, 0.0, FINGER_TIP_M - 0.003 - pose[2, 3]]))
    assert line is not None
    slow = slow_end(robot, line, station.execute, lambda _: True, lambda _: False)
    reach = timed(station, blended([line]), slow_end=slow)
    return reach.model_copy(update={"guard": guard(robot, reach, 100, station.execute.contact_n)})


def _back(motion: Motion) -> np.ndarray:
    return way_back(load_station(), motion.commanded_q_rad).raw_q_rad
