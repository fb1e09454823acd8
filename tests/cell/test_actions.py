"""What the machine's works do with the simulated devices, and leave behind when one of them fails."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from bus.arrays import Joints
from bus.clock import WALL_CLOCK
from bus.codes import Code
from bus.commands import Presented, PresentRequest
from bus.errors import CellError, ConfigError, CycleFailure, DriverError, MotionRefused
from bus.messages import ArmMode, CycleResult
from bus.trajectory import Trajectory
from cell.daemon.actions import Actions
from cell.machine import standstill
from cell.machine.gate import Gate
from cell.pick.equipment import Equipment
from config.load import load_station
from drivers.interface import ObjectPresenter
from drivers.node.registry import open_devices
from drivers.sim.world import World
from logs.mcap.reader import read_cycle
from perception.models import open_models
from planning.robot import Robot


class Restless:
    """An object presenter whose objects roll away, or that fails itself.

    Args:
        error: what presenting raises.
    """

    def __init__(self, error: CellError) -> None:
        self._error = error

    def present(self, request: PresentRequest) -> Presented:
        raise self._error

    def truth(self) -> Presented:
        raise NotImplementedError


class Bench:
    """Works with simulated devices; the result they say, and a hold at a chosen instant of a chosen stage."""

    def __init__(self, folder: Path, presenter: ObjectPresenter | None = None) -> None:
        station = load_station(None, [f"recording.folder={folder}"])
        devices = open_devices("sim", station)
        assert devices.camera is not None and devices.arm is not None and devices.hand is not None
        for device in (devices.camera, devices.arm, devices.hand):
            device.connect()
        self.arm, self.camera = devices.arm, devices.camera
        equipment = Equipment(
            devices.camera, devices.arm, devices.hand, Robot(station), station, open_models(station, {})
        )
        self.results: list[CycleResult] = []
        self.gate = Gate()
        self.actions = Actions(
            equipment,
            self.gate,
            presenter or devices.presenter,
            lambda: set(station.nodes),
            lambda topic, message: None,
            self._on_stage,
            self.results.append,
        )
        self._stage = ""
        self._ticks_to_hold = {"execute": 500, "deliver": 500}
        self.moving = threading.Event()

    def _on_stage(self, stage: str) -> None:
        self._stage = stage

    def tick(self) -> None:
        """Called with every command to the arm: holds in the middle of its first motion of each stage that moves."""
        left = self._ticks_to_hold.get(self._stage, 0)
        self._ticks_to_hold[self._stage] = left - 1
        if left == 1:
            self.gate.hold()
            self.arm.hold()
            self.moving.set()

    def run(self, work: Callable[[], None]) -> threading.Thread:
        """``work`` in a thread of its own, as the machine does it; back when it is being held."""
        self.moving.clear()
        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        assert self.moving.wait(60)
        return thread

    def held_q_rad(self, thread: threading.Thread) -> Joints:
        """Where the arm rests, in the middle of a motion that waits; the world stands still."""
        give_up_s = time.monotonic() + 60
        while np.abs((state := self.arm.state()).dq_rad_s).max() >= 1e-3:
            assert time.monotonic() < give_up_s
        assert thread.is_alive() and self.gate.is_moving and state.mode is ArmMode.MOVE
        np.testing.assert_array_equal(self.arm.state().q_rad, state.q_rad)
        return state.q_rad


@pytest.fixture
def make_bench(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    """Makes benches, and closes their cameras: a graphics context left open keeps hundreds of megabytes."""
    with ExitStack() as stack:

        def make(presenter: ObjectPresenter | None = None) -> Bench:
            bench = Bench(tmp_path, presenter)
            stack.callback(bench.camera.close)
            return bench

        yield make


@pytest.fixture
def bench(make_bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch) -> Bench:
    bench = make_bench()
    command_arm = World.command_arm

    def watched(world: World, q_rad: np.ndarray, last_q_rad: np.ndarray) -> None:
        command_arm(world, q_rad, last_q_rad)
        bench.tick()

    monkeypatch.setattr(World, "command_arm", watched)
    return bench


def test_a_cycle_held_in_its_pick_and_in_its_delivery_succeeds(bench: Bench) -> None:
    actions = bench.actions
    actions.reset()
    actions.begin()
    for work in (actions.pick, actions.complete):
        thread = bench.run(work)
        actions.hold()
        bench.held_q_rad(thread)
        actions.unhold()
        thread.join(60)
        assert not thread.is_alive() and not bench.gate.is_moving
    (result,) = bench.results
    assert result.result == "SUCCESS", result.reason
    bench.camera.close()


def test_a_stop_ends_a_held_cycle_and_nothing_moves_afterwards(bench: Bench) -> None:
    actions = bench.actions
    actions.reset()
    actions.begin()

    def pick() -> None:
        with pytest.raises(CycleFailure, match="Stopped during 'reach'"):
            actions.pick()

    thread = bench.run(pick)
    actions.hold()
    held_q_rad = bench.held_q_rad(thread)

    def no_action_running(wait_s: float) -> bool:
        thread.join(wait_s)
        return not thread.is_alive()

    actions.stop(no_action_running)
    (result,) = bench.results
    assert (result.result, result.code) == ("ABORTED", Code.STOPPED)
    bench.gate.release()
    state = bench.arm.state()
    assert state.mode is ArmMode.IDLE
    np.testing.assert_allclose(state.q_rad, held_q_rad, atol=1e-3)
    bench.gate.clear()
    actions.reset()


def test_a_hold_between_motions_is_held_at_once_and_the_next_one_waits(bench: Bench) -> None:
    actions, began = bench.actions, threading.Event()
    bench.gate.hold()
    actions.hold()

    def next_motion() -> None:
        with bench.gate.motion() as may_begin:
            assert may_begin
            began.set()

    thread = threading.Thread(target=next_motion, daemon=True)
    thread.start()
    assert not began.wait(0.05)
    actions.unhold()
    assert began.wait(60)
    thread.join(60)


def test_a_motion_on_its_way_to_the_arm_is_held_when_it_arrives(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    actions, passed, arrives = bench.actions, threading.Event(), threading.Event()
    still = Trajectory(raw_q_rad=np.repeat(bench.arm.state().q_rad[None], 2000, axis=0), window=1)

    def motion() -> None:
        with bench.gate.motion():
            passed.set()
            assert arrives.wait(60)
            bench.arm.execute(still)

    moving = threading.Thread(target=motion, daemon=True)
    moving.start()
    assert passed.wait(60)
    bench.gate.hold()
    holding = threading.Thread(target=actions.hold, daemon=True)
    holding.start()
    holding.join(0.05)
    assert holding.is_alive()
    arrives.set()
    holding.join(60)
    assert not holding.is_alive()
    actions.unhold()
    moving.join(60)
    assert not moving.is_alive()


def test_a_motion_that_was_over_as_the_hold_came_needs_no_resume(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    actions, over = bench.actions, threading.Event()

    def motion() -> None:
        with bench.gate.motion():
            over.wait(60)

    def resume() -> None:
        over.set()
        raise MotionRefused("Nothing is held.")

    monkeypatch.setattr(bench.arm, "resume", resume)
    thread = threading.Thread(target=motion, daemon=True)
    thread.start()
    while not bench.gate.is_moving:
        pass
    bench.gate.hold()
    actions.unhold()
    thread.join(60)
    assert not bench.gate.is_moving


def test_a_motion_that_neither_goes_on_nor_ends_is_an_error(bench: Bench) -> None:
    with bench.gate.motion(), pytest.raises(MotionRefused):
        standstill.unhold(bench.arm, bench.gate, WALL_CLOCK, ending_s=0.01)


def test_an_object_that_cannot_be_presented_fails_its_own_pick_only(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(Restless(ConfigError("The object 'ball' does not come to rest.", "Is it round?")))
    actions, results = bench.actions, bench.results
    for _ in range(2):
        actions.begin()
        actions.pick()
        actions.complete()
    assert [(result.result, result.code, result.stages) for result in results] == [("FAILED", Code.NO_OBJECT, {})] * 2
    assert "does not come to rest" in results[0].reason
    assert read_cycle(Path(results[0].recording)).result == results[0]


def test_a_simulator_that_fails_is_the_reason_of_its_cycle(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(Restless(DriverError("The simulator ended.", "Start it again.")))
    actions, results = bench.actions, bench.results
    with pytest.raises(CycleFailure, match="simulator ended"):
        actions.begin()
    actions.stop(lambda wait_s: True)
    (result,) = results
    assert (result.result, result.code) == ("ABORTED", Code.INTERNAL)
    assert "simulator ended" in result.reason
    assert read_cycle(Path(result.recording)).result == result
