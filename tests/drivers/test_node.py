"""A node: its name is served once, its arm brakes when the cell falls silent, and it does not outlive its threads."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import cast

import numpy as np
import pytest

from bus import topics
from bus.clock import WALL_CLOCK, DeadlineClock, WallClock
from bus.codec import decode
from bus.codes import ADVICE, Code
from bus.commands import Event, Health, Heartbeat, Nothing
from bus.errors import BadFrame, DriverUnavailable, StaleFrame
from bus.messages import ArmMode, ArmState, Frame, Motion
from bus.messages.frame_checks import MADE_WRONG
from bus.sample import Sample
from bus.session import Bus
from bus.trajectory import Trajectory
from config.load import load_station
from config.schema import Station
from drivers.interface import Arm, Devices
from drivers.motion.unmoved import unmoved
from drivers.node.node import Node
from drivers.remote import RemoteArm, RemoteCamera
from stand_ins.starved import StarvedMachine

STILL = Trajectory(raw_q_rad=np.repeat(np.array([[0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8]]), 2, axis=0), window=1)
REST = ArmState(stamp_ns=1, mode=ArmMode.IDLE, q_rad=STILL.start_q_rad, dq_rad_s=np.zeros(7), tau_ext_nm=np.zeros(7))


class PatientArm:
    """Its motions last until they are stopped."""

    def __init__(self) -> None:
        self.moving, self._stopped = threading.Event(), threading.Event()

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def state(self) -> ArmState:
        return REST

    def execute(self, trajectory: Trajectory) -> Motion:
        self._stopped.clear()
        self.moving.set()
        self._stopped.wait(60)
        self.moving.clear()
        return unmoved(REST, trajectory)

    def stop(self) -> None:
        self._stopped.set()


class StillCamera:
    """Gives the same frame for ever."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def capture(self) -> Frame:
        return self._frame


class RgbaCamera(StillCamera):
    """Its pictures have four channels: a driver's mistake, told where it makes a frame."""

    def capture(self) -> Frame:
        color = np.dstack([self._frame.color, self._frame.color[..., :1]])
        return Frame(**{**dict(self._frame), "color": color})


@pytest.fixture
def station(endpoint: str) -> Station:
    """Patient enough for a busy machine."""
    return load_station(None, ["sim.pace=1", f"bus.endpoint={endpoint}", "bus.silence_s=2"])


@pytest.fixture
def cell(station: Station, endpoint: str) -> Iterator[Bus]:
    with Bus.listen(station.cell_id, endpoint) as bus:
        yield bus


@contextmanager
def node_of(
    station: Station,
    arm: PatientArm | None = None,
    name: str = "sim",
    clock: DeadlineClock = WALL_CLOCK,
    camera: StillCamera | None = None,
) -> Iterator[Node]:
    devices = Devices(camera=camera, arm=cast(Arm, arm) if arm is not None else None)
    with Bus.join(station.cell_id, station.bus.endpoint, clock=clock) as bus:
        node = Node(name, bus, devices, station)
        node.open()
        try:
            yield node
        finally:
            node.close()


def until(holds: Callable[[], bool], patience_s: float = 60.0) -> None:
    give_up_s = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)


def test_a_name_is_served_once_and_the_second_is_told_of_the_firsts_process(cell: Bus, station: Station) -> None:
    with node_of(station):
        until(lambda: cell.alive(topics.NODE_ALIVE) == {"sim"})
        with pytest.raises(DriverUnavailable, match=f"already: process {os.getpid()}"), node_of(station):
            pass
        with node_of(station, name="other"):
            pass
    until(lambda: not cell.alive(topics.NODE_ALIVE))
    with node_of(station):  # the name is free again
        pass


def test_a_frame_that_cannot_be_is_refused_at_its_node_and_named_to_who_asked(
    cell: Bus, station: Station, frame: Frame
) -> None:
    with node_of(station, camera=RgbaCamera(frame)):
        camera = RemoteCamera(cell, timeout_s=60)
        camera.connect()
        with pytest.raises(BadFrame, match=r"Frame.color has the shape \(90, 160, 4\).*RGBA") as refused:
            camera.capture()
    assert refused.value.code == Code.BAD_FRAME and refused.value.advice == MADE_WRONG


def test_a_frame_that_comes_twice_is_refused_whoever_had_it_first(cell: Bus, station: Station, frame: Frame) -> None:
    """So that a camera that hangs between the test of a start and its first look is no empty table."""
    with node_of(station, camera=StillCamera(frame)):
        camera = RemoteCamera(cell, timeout_s=60)
        camera.connect()
        camera.capture()
        with pytest.raises(StaleFrame, match="last frame again") as refused:
            camera.capture()
    assert refused.value.advice == ADVICE[Code.STALE_FRAME]


def test_of_many_that_begin_in_the_same_moment_one_stays(cell: Bus, station: Station) -> None:
    begun, outcomes, over = threading.Barrier(4), list[str](), threading.Event()

    def begin() -> None:
        begun.wait(60)
        try:
            with node_of(station):
                outcomes.append("serves")
                over.wait(60)
        except DriverUnavailable:
            outcomes.append("refused")

    threads = [threading.Thread(target=begin) for _ in range(4)]
    for thread in threads:
        thread.start()
    until(lambda: len(outcomes) == 4)
    over.set()
    for thread in threads:
        thread.join()
    assert outcomes.count("serves") <= 1


def test_who_a_node_is_can_be_asked(cell: Bus, station: Station) -> None:
    with node_of(station):
        until(lambda: "sim" in cell.alive(topics.NODE_ALIVE))
        health = cell.request(topics.NODE_NOW, Nothing(), Health, timeout_s=60, name="sim")
    assert (health.name, health.pid) == ("sim", os.getpid())


# --- the cell's heartbeat ---------------------------------------------------------------------------------------------


@contextmanager
def moving(cell: Bus, station: Station, clock: DeadlineClock = WALL_CLOCK) -> Iterator[PatientArm]:
    """A motion under way that the cell has asked for."""
    arm = PatientArm()
    with node_of(station, arm, clock=clock):
        remote = RemoteArm(cell, 5.0)
        remote.connect()
        until(lambda: "sim" in cell.alive(topics.NODE_ALIVE))
        asking = threading.Thread(target=partial(remote.execute, STILL))
        asking.start()
        assert arm.moving.wait(60)
        try:
            yield arm
        finally:
            arm.stop()
            asking.join(60)


def _beat(cell: Bus, seconds: float) -> None:
    for _ in range(round(seconds / 0.1)):
        cell.publish(topics.HEARTBEAT, Heartbeat())
        time.sleep(0.1)


def test_an_arm_brakes_when_the_cell_that_was_heard_falls_silent_and_says_so(cell: Bus, station: Station) -> None:
    """The node's time passes as the test lets it: a machine that is busy with something else has not fallen silent."""
    events: list[Sample] = []
    cell.subscribe(topics.EVENT.key, events.append)
    passed_s = 0.0
    with moving(cell, station, WallClock(lambda: passed_s)) as arm:
        while passed_s < 4 * station.silence_s:
            cell.publish(topics.HEARTBEAT, Heartbeat())
            cell.request(topics.NODE_NOW, Nothing(), Health, timeout_s=60, name="sim")  # it has heard that by now
            passed_s += 0.1
        assert arm.moving.is_set(), "a cell that is heard is obeyed"

        def has_braked() -> bool:
            nonlocal passed_s
            passed_s += 0.01
            return not arm.moving.is_set()

        until(has_braked)
        assert not events, "nobody is there to hear it"

        def is_told() -> bool:
            cell.publish(topics.HEARTBEAT, Heartbeat())
            return bool(events)

        until(is_told)
    event = decode(Event, events[0].payload)
    assert event.code == "CELL_SILENT" and "said nothing" in event.text


@pytest.mark.thorough
def test_in_a_simulation_a_cell_may_be_silent_for_as_much_longer_as_the_machine_is_busy(
    cell: Bus, station: Station
) -> None:
    machine = StarvedMachine(slowdown=10.0)
    with moving(cell, station, machine.clock) as arm:
        _beat(cell, 0.3)
        silent_s = 0.0
        while arm.moving.is_set():
            silent_s += 0.5
            machine.passes(0.5)
            machine.await_looks(2)  # the node's, whether it is to brake
            assert silent_s < 60.0
    assert silent_s == pytest.approx(10.0 * station.silence_s, abs=2.0)


def test_a_strangers_heartbeat_does_not_keep_an_arm_moving(cell: Bus, station: Station) -> None:
    with moving(cell, station) as arm, Bus.join(station.cell_id, station.bus.endpoint) as stranger:
        _beat(cell, 0.2)

        def end() -> bool:
            stranger.publish(topics.HEARTBEAT, Heartbeat())
            return not arm.moving.is_set()

        until(end)


def test_a_simulation_without_time_waits_longer() -> None:
    station = load_station(None, ["sim.pace=1"])
    timeless = station.model_copy(update={"sim": station.sim.model_copy(update={"pace": 0.0})})
    assert (station.silence_s, timeless.silence_s) == (0.5, 5.0)
    hardware = station.model_copy(update={"nodes": {}})
    assert hardware.silence_s == 0.5


# --- its threads ------------------------------------------------------------------------------------------------------


def test_a_node_that_is_not_whole_stops_its_arm_and_tells_why(cell: Bus, station: Station) -> None:
    events: list[Sample] = []
    cell.subscribe(topics.EVENT.key, events.append)
    arm = PatientArm()
    with node_of(station, arm) as node:
        node.end_by_defect("loop-arm.state", KeyError("unforeseen"))
        until(lambda: bool(events))
    event = decode(Event, events[0].payload)
    assert (event.code, "loop-arm.state met KeyError" in event.text) == ("INTERNAL", True)
    assert arm._stopped.is_set()
