"""The hand opens while the arm reaches; with fingers that are not open the arm never begins the approach line."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from bus.errors import ArmReflex, DeviceLost, HandFault
from bus.messages import HandState, Motion
from bus.trajectory import Trajectory
from cell.machine import standstill
from cell.machine.gate import Gate
from cell.pick.execute import _Runner
from config.clock import clock_of
from config.load import load_station
from drivers.sim.arm import SimArm
from drivers.sim.hand import SimHand
from drivers.sim.world import World

STATION = load_station()
APPROACH_AT = 700
WIDE_M, OPENING_M = STATION.hand.max_width_m, 0.05
Move = Callable[[float, float], HandState]


class Hand(SimHand):
    """The simulated hand; each move waits until a test lets it, and may be another than its own."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.may_move = threading.Event()
        self.may_move.set()
        self.moves: Move = super().move

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        assert self.may_move.wait(60)
        return self.moves(width_m, speed_m_s)


class Bench:
    """An arm that is to turn joint 7 by 1 rad, and its hand, in a thread of their own."""

    def __init__(self) -> None:
        self.world, self.gate = World(STATION), Gate()
        self.arm, self.hand = SimArm(self.world), Hand(self.world)
        self.arm.connect()
        self.hand.connect()
        self.hand.move(WIDE_M, 0.1)
        self.runner = _Runner(self.arm, self.hand, self.gate, STATION.hand)
        q_rad = np.repeat(self.world.arm()[0][None], 1500, axis=0)
        q_rad[:, 6] += 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 1500))
        self.trajectory = Trajectory(raw_q_rad=q_rad, window=64)
        self.limit_rad = self.trajectory.filtered()[APPROACH_AT, 6]
        self.arrived: bool | None = None
        self.failure: Exception | None = None
        self.thread = threading.Thread(target=self._reach, daemon=True)

    def _reach(self) -> None:
        try:
            self.arrived = self.runner.reach(self.trajectory.model_copy(update={"waits_at": APPROACH_AT}), OPENING_M)
        except Exception as error:  # noqa: BLE001 - a test looks at it
            self.failure = error

    def end(self) -> None:
        self.thread.join(60)
        assert not self.thread.is_alive()

    def is_beyond(self) -> bool:
        """Whether the arm has begun the approach."""
        return bool(self.world.arm()[0][6] > self.limit_rad + 1e-3)

    def wait_until_the_arm_waits(self) -> None:
        self.until(lambda: self.world.arm()[0][6] > self.trajectory.start_q_rad[6] + 0.02)
        self.until(lambda: np.abs(self.world.arm_speed_rad_s()).max() < 0.02)

    def until(self, holds: Callable[[], object]) -> None:
        give_up_s = time.monotonic() + 60
        while not holds():
            assert time.monotonic() < give_up_s
            time.sleep(0.001)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.gate.halt()
    bench.hand.may_move.set()
    bench.arm.stop()
    bench.end()


def test_both_move_at_once_and_the_arm_does_not_wait(bench: Bench) -> None:
    bench.thread.start()
    bench.end()
    assert bench.failure is None and bench.arrived
    (run,) = bench.runner.runs
    assert run.hand.width_m == pytest.approx(OPENING_M, abs=1e-3)
    assert not run.hand.is_moving


def test_the_arm_waits_for_a_slow_hand_and_then_goes_on(bench: Bench) -> None:
    bench.hand.may_move.clear()
    bench.thread.start()
    bench.wait_until_the_arm_waits()
    assert not bench.is_beyond() and bench.arrived is None
    bench.hand.may_move.set()
    bench.end()
    assert bench.arrived and bench.failure is None


def _stays(bench: Bench) -> Move:
    return lambda _width_m, _speed_m_s: bench.hand.state()


def _is_lost(_bench: Bench) -> Move:
    def move(_width_m: float, _speed_m_s: float) -> HandState:
        raise DeviceLost("The hand does not answer.", "Check it.")

    return move


@pytest.mark.parametrize(("fault", "error"), [(_stays, HandFault), (_is_lost, DeviceLost)])
@pytest.mark.parametrize("late", [False, True])
def test_a_hand_that_does_not_open_keeps_the_arm_from_the_approach(
    bench: Bench, fault: Callable[[Bench], Move], error: type[Exception], late: bool
) -> None:
    bench.hand.moves = fault(bench)
    if late:
        bench.hand.may_move.clear()
    bench.thread.start()
    if late:
        bench.wait_until_the_arm_waits()
        bench.hand.may_move.set()
    bench.end()
    assert isinstance(bench.failure, error) and not bench.is_beyond()
    assert all(not run.motion.finished for run in bench.runner.runs)


def test_a_hold_is_confirmed_only_when_the_hand_is_open_because_its_end_lets_the_arm_go_on(bench: Bench) -> None:
    bench.hand.may_move.clear()
    bench.thread.start()
    bench.until(lambda: bench.gate.under_way == 2)
    bench.gate.hold()
    holding = threading.Thread(target=standstill.hold, args=(bench.arm, bench.gate, 60.0, clock_of(STATION)))
    holding.start()
    bench.until(lambda: np.abs(bench.world.arm_speed_rad_s()).max() < 1e-3)
    assert holding.is_alive() and not bench.is_beyond()
    bench.hand.may_move.set()
    holding.join(60)
    assert not holding.is_alive() and not bench.is_beyond()
    assert bench.hand.state().width_m == pytest.approx(OPENING_M, abs=1e-3)
    standstill.unhold(bench.arm, bench.gate, clock_of(STATION))
    bench.end()
    assert bench.arrived and bench.failure is None


def test_a_stop_ends_both(bench: Bench) -> None:
    bench.hand.may_move.clear()
    bench.thread.start()
    bench.until(lambda: bench.gate.under_way == 2)
    bench.hand.may_move.set()

    def over(wait_s: float) -> bool:
        bench.thread.join(wait_s)
        return not bench.thread.is_alive()

    standstill.stop(bench.arm, bench.hand, bench.gate, over, 60.0, clock_of(STATION))
    assert bench.arrived is False and bench.failure is None and not bench.is_beyond()
    assert bench.runner.stopped_in == "reach"


def test_halted_neither_begins(bench: Bench) -> None:
    bench.gate.halt()
    bench.thread.start()
    bench.end()
    assert bench.arrived is False and bench.runner.stopped_in == "open" and bench.runner.runs == []
    assert bench.hand.state().width_m == pytest.approx(WIDE_M, abs=1e-3)


def test_an_arm_that_stops_itself_stops_the_hand(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped = threading.Event()

    def reflex(_trajectory: Trajectory) -> Motion:
        raise ArmReflex("The arm touched something.", "Clear it.")

    monkeypatch.setattr(bench.arm, "execute", reflex)
    monkeypatch.setattr(bench.hand, "stop", stopped.set)
    bench.thread.start()
    bench.end()
    assert isinstance(bench.failure, ArmReflex) and stopped.is_set()
