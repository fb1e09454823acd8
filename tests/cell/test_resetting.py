"""Between two picks of one command nothing is tried again that the last pick has just shown to work."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bus.errors import HandFault, StaleFrame
from bus.messages import ArmMode, ArmState, Frame, HandState
from bus.trajectory import Trajectory
from cell.daemon.grip import Grip, GripHand
from cell.daemon.resetting import reset
from cell.machine.gate import Gate
from cell.pick.equipment import Equipment
from cell.pick.execute import _Runner
from config.load import load_station
from config.schema import Station
from drivers.interface import Arm, Camera, Hand
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


def _grip(station: Station) -> Grip:
    return Grip(station.hand, station.verify.min_width_m)


def _reset(equipment: Equipment, *, goes_on: bool) -> float:
    """Reset, and return how much simulated time that took [s]."""
    before_s = equipment.hand.state().clock_s
    station = equipment.station
    reset(equipment, _grip(station), Gate(), set(station.nodes), goes_on=goes_on)
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


@pytest.fixture
def station(tmp_path: Path) -> Station:
    return load_station(None, [f"recording.folder={tmp_path}", "recording.min_free_mb=0"])


class Narrated:
    """Arm and hand of a cell without physics: the hand stands on what it closed on; every motion is kept, in words."""

    def __init__(self, station: Station, *, thing_m: float = 0.0, is_stuck: bool = False) -> None:
        self.did: list[str] = []
        self._thing_m, self._is_stuck, self._width_m = thing_m, is_stuck, thing_m
        self._q_rad = np.asarray(station.arm.capture_q_rad) + np.array([0.5, 0, 0, 0, 0, 0, 0])

    @property
    def arm(self) -> Arm:
        still, mode = np.zeros(7), ArmMode.IDLE
        state = ArmState(stamp_ns=0, mode=mode, q_rad=self._q_rad, dq_rad_s=still, tau_ext_nm=still)
        return cast(Arm, SimpleNamespace(state=lambda: state, execute=self._execute))

    def _execute(self, _way: Trajectory) -> Any:
        self.did.append("arm")
        return SimpleNamespace(finished=True)

    def state(self) -> HandState:
        return HandState(stamp_ns=0, width_m=self._width_m, is_moving=False, is_homed=True)

    def move(self, width_m: float, _speed_m_s: float) -> HandState:
        self.did.append(f"hand {width_m * 1e3:.0f}")
        self._width_m = self._width_m if self._is_stuck else width_m
        return self.state()

    def grasp(self, _force_n: float, _speed_m_s: float) -> HandState:
        self._width_m = self._thing_m
        return self.state()


def _reset_of(did: Narrated, station: Station, *, came_m: float | None) -> list[str]:
    """What a reset does, after fingers that were ``came_m`` apart closed on the thing; None = nobody knows of that."""
    grip = _grip(station)
    hand = GripHand(cast(Hand, did), grip)
    if came_m is not None:
        hand.move(came_m, 0.1)
        hand.grasp(30.0, 0.1)
        did.did.clear()
    e = Equipment(cast(Camera, NoCamera()), did.arm, hand, Robot(station), station, cast(Models, None))
    reset(e, grip, Gate(), set(station.nodes), goes_on=True)
    return did.did


@pytest.mark.parametrize(
    ("thing_m", "came_m", "then"),
    [
        pytest.param(0.040, 0.060, ["hand 60", "arm", "hand 80"], id="as wide as the fingers came: room was there"),
        pytest.param(0.040, 0.042, ["hand 50", "arm", "hand 80"], id="and the release margin wider than the thing"),
        pytest.param(0.040, None, ["hand 80", "arm"], id="all the way when nobody knows how they came"),
        pytest.param(0.0, 0.060, ["arm", "hand 80"], id="where nothing is held the hand opens where there is room"),
    ],
)
def test_what_may_be_in_the_hand_is_let_go_before_the_arm_moves(
    station: Station, thing_m: float, came_m: float | None, then: list[str]
) -> None:
    assert _reset_of(Narrated(station, thing_m=thing_m), station, came_m=came_m) == then


def test_the_arm_rests_when_the_hand_does_not_open(station: Station) -> None:
    stuck = Narrated(station, thing_m=0.04, is_stuck=True)
    with pytest.raises(HandFault, match="stands at 40"):
        _reset_of(stuck, station, came_m=None)
    assert stuck.did == ["hand 80"]


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
