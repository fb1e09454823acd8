"""A stop or hold that comes when a motion was asked for and has not begun, for every arm and hand.

Simulated ones wait for their world before they move; there the motion is kept until the stop has come.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import numpy as np
import pytest

from bus.messages import ArmMode, HandState, Motion
from bus.session import Bus
from bus.trajectory import Trajectory
from config.load import load_station
from drivers.interface import Arm, Devices, Hand
from drivers.node.fault_injection import FaultyArm, FaultyHand
from drivers.node.node import Node
from drivers.remote import RemoteArm, RemoteHand
from drivers.sim.arm import SimArm
from drivers.sim.hand import SimHand
from drivers.sim.turns import Turns
from drivers.sim.world import World

STATION = load_station()
AnswerT = TypeVar("AnswerT")


class Door(Turns):
    """The world's turns; once shut, the next who comes waits until it is opened."""

    def __init__(self) -> None:
        super().__init__()
        self._shut, self._come, self._open = False, threading.Event(), threading.Event()

    @contextmanager
    def taken(self) -> Iterator[None]:
        self._wait()
        with super().taken():
            yield

    def ride(self, is_over: Callable[[], bool], tick: Callable[[], None]) -> None:
        self._wait()
        super().ride(is_over, tick)

    def _wait(self) -> None:
        if self._shut:
            self._come.set()
            assert self._open.wait(60)

    @contextmanager
    def before(self, ask: Callable[[], AnswerT]) -> Iterator[list[AnswerT]]:
        """Inside, ``ask`` was called and waits at the door; after it, it has returned and left its answer."""
        self._shut, answers = True, []
        asking = threading.Thread(target=lambda: answers.append(ask()))
        asking.start()
        assert self._come.wait(60)
        yield answers
        self._shut = False
        self._open.set()
        asking.join(60)
        self._come.clear()
        self._open.clear()
        assert not asking.is_alive()


class Bench:
    """A world behind a door, with its arm and hand as one implementation gives them."""

    def __init__(self, implementation: str, stack: ExitStack, endpoint: str) -> None:
        self.world, self.door = World(STATION), Door()
        self.world.turns = self.door
        self.arm: Arm = SimArm(self.world)
        self.hand: Hand = SimHand(self.world)
        if implementation == "faulty":
            self.arm, self.hand = FaultyArm(self.arm), FaultyHand(self.hand)
        if implementation == "remote":
            cell = stack.enter_context(Bus.listen(STATION.cell_id, endpoint))
            node_bus = stack.enter_context(Bus.join(STATION.cell_id, endpoint))
            node = Node("sim", node_bus, Devices(arm=self.arm, hand=self.hand), STATION)
            node.open()
            stack.callback(node.close)
            self.arm, self.hand = RemoteArm(cell, 10.0), RemoteHand(cell, 10.0)
        for device in (self.arm, self.hand):
            device.connect()

    def nod(self) -> Trajectory:
        """Joint 7, 0.2 rad away and back."""
        q_rad = np.repeat(self.world.arm()[0][None], 1000, axis=0)
        q_rad[:, 6] += 0.2 * (0.5 - 0.5 * np.cos(np.linspace(0.0, 2 * np.pi, 1000))) ** 2
        return Trajectory(raw_q_rad=q_rad, window=64)


@pytest.fixture(scope="module", params=["sim", "faulty", "remote"])
def bench(request: pytest.FixtureRequest, new_endpoint: Callable[[], str]) -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(request.param, stack, new_endpoint())


HAND_MOTIONS: dict[str, Callable[[Hand], HandState]] = {
    "move": lambda hand: hand.move(0.01, 0.1),
    "grasp": lambda hand: hand.grasp(30.0, 0.1),
    "home": lambda hand: hand.home(),
}


@pytest.mark.parametrize("motion", HAND_MOTIONS)
def test_a_hand_that_is_stopped_before_it_begins_does_not_move(bench: Bench, motion: str) -> None:
    before_m = bench.hand.move(0.05, 0.1).width_m
    with bench.door.before(lambda: HAND_MOTIONS[motion](bench.hand)) as answers:
        bench.hand.stop()
    (state,) = answers
    assert state.width_m == pytest.approx(before_m, abs=1e-4)
    assert not state.is_moving and not state.is_homed
    assert bench.hand.move(0.04, 0.1).width_m == pytest.approx(0.04, abs=2e-3), "what is asked for later moves"


def test_an_arm_that_is_stopped_before_it_begins_does_not_move(bench: Bench) -> None:
    before_q_rad = bench.world.arm()[0]
    trajectory = bench.nod()
    with bench.door.before(lambda: bench.arm.execute(trajectory)) as answers:
        bench.arm.stop()
    assert _moved_rad(answers, before_q_rad, bench) < 1e-3 and not answers[0].finished
    assert bench.arm.state().mode is ArmMode.IDLE
    assert bench.arm.execute(bench.nod()).finished, "what is asked for later moves"


@pytest.mark.parametrize("ending", ["resume", "stop"])
def test_an_arm_that_is_held_before_it_begins_waits_for_what_comes_then(bench: Bench, ending: str) -> None:
    before_q_rad = bench.world.arm()[0]
    trajectory = bench.nod()
    with bench.door.before(lambda: bench.arm.execute(trajectory)) as answers:
        bench.arm.hold()
        getattr(bench.arm, ending)()
    assert answers[0].finished == (ending == "resume")
    assert (_moved_rad(answers, before_q_rad, bench) > 0.1) == (ending == "resume")


def _moved_rad(answers: list[Motion], before_q_rad: np.ndarray, bench: Bench) -> float:
    measured: Any = np.concatenate([answers[0].q_rad, bench.world.arm()[0][None]])
    return float(np.abs(measured - before_q_rad).max())


def test_a_homing_that_is_stopped_half_way_neither_opens_nor_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(STATION)
    hand = SimHand(world)
    hand.connect()
    monkeypatch.setattr(world, "pace", lambda tick: hand.stop() if tick == 400 else None)
    state = hand.home()
    assert not state.is_homed and state.width_m < 0.05


def test_an_error_in_a_motion_leaves_no_hand_moving(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(STATION)
    hand = SimHand(world)
    hand.connect()
    monkeypatch.setattr(world, "pace", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        hand.move(0.02, 0.1)
    assert not hand.state().is_moving
