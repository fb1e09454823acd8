"""Between two picks of one command nothing is tried again that the last pick has just shown to work."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest

from bus.errors import StaleFrame
from bus.messages import Frame
from cell.daemon.resetting import reset
from cell.machine.gate import Gate
from cell.pick.equipment import Equipment
from cell.pick.execute import _Runner
from config.load import load_station
from drivers.interface import Camera
from drivers.sim.arm import SimArm
from drivers.sim.hand import SimHand
from drivers.sim.world import World
from perception.models import Models
from planning.robot import Robot
from planning.timing import rest_to_rest

WIDE_M = load_station().hand.max_width_m


class NoCamera:
    """A camera that refuses to be asked."""

    def connect(self) -> None:
        """Nothing is opened."""

    def close(self) -> None:
        """Nothing is open."""

    def capture(self) -> Frame:
        raise StaleFrame("A frame was asked for.")


@pytest.fixture
def equipment(tmp_path: Path) -> Equipment:
    return _equipment(tmp_path)


def _equipment(folder: Path, *options: str) -> Equipment:
    station = load_station(None, [f"recording.folder={folder}", "recording.min_free_mb=0", *options])
    world = World(station)
    arm, hand = SimArm(world), SimHand(world)
    arm.connect()
    hand.connect()
    return Equipment(cast(Camera, NoCamera()), arm, hand, Robot(station), station, cast(Models, None))


def _reset(equipment: Equipment, *, goes_on: bool) -> float:
    """Reset, and return how much simulated time that took [s]."""
    before_s = equipment.hand.state().clock_s
    reset(equipment, Gate(), set(equipment.station.nodes), goes_on=goes_on)
    after_s = equipment.hand.state().clock_s
    assert before_s is not None and after_s is not None
    return after_s - before_s


def test_after_a_pick_neither_the_arm_nor_an_open_hand_moves_and_no_frame_is_asked_for(equipment: Equipment) -> None:
    equipment.hand.home()
    equipment.hand.move(WIDE_M, 0.1)
    assert _reset(equipment, goes_on=True) == 0.0


def test_a_hand_that_is_not_open_is_opened(equipment: Equipment) -> None:
    equipment.hand.home()
    equipment.hand.move(0.03, 0.1)
    assert _reset(equipment, goes_on=True) > 0.3
    assert equipment.hand.state().width_m == pytest.approx(WIDE_M, abs=0.002)


def test_the_reset_of_a_person_asks_for_a_fresh_frame(equipment: Equipment) -> None:
    with pytest.raises(StaleFrame, match="asked for"):
        _reset(equipment, goes_on=False)


def test_on_the_way_home_the_hand_opens_without_that_the_arm_waits_for_it(tmp_path: Path) -> None:
    """In real time: otherwise the arm may be there before the thread of the hand has begun."""
    equipment = _equipment(tmp_path, "sim.pace=1")
    station, arm, hand = equipment.station, equipment.arm, equipment.hand
    hand.home()
    hand.move(0.04, 0.1)
    home_q_rad = np.asarray(station.arm.capture_q_rad)
    home = rest_to_rest(station, arm.state().q_rad, home_q_rad + np.array([0.5, 0, 0, 0, 0, 0, 0]))
    before_s = hand.state().clock_s
    runner = _Runner(arm, hand, Gate(), station.hand)
    assert runner.go_home(home)
    after_s = hand.state().clock_s
    assert before_s is not None and after_s is not None
    assert after_s - before_s == pytest.approx(home.duration_s, abs=0.15)
    assert hand.state().width_m == pytest.approx(WIDE_M, abs=0.002)
