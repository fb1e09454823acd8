"""What a cycle makes of devices that lie: it ends with the device's own code, and never calls it a pick."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure, DeviceLost, StaleFrame
from bus.fault_injection import Fault
from bus.messages import CycleResult, Frame
from cell.daemon.actions import Actions
from cell.machine.gate import Gate
from cell.pick.capture import capture
from cell.pick.equipment import Equipment
from config.load import load_station
from drivers.node.fault_injection import FaultyArm, FaultyCamera, FaultyHand
from drivers.node.guard import Guard
from drivers.node.registry import open_devices
from perception.models import open_models
from planning.robot import Robot


class Bench:
    """Works whose devices can be spoiled: when the stage of ``spoil`` begins, its device gets its fault."""

    def __init__(self, folder: Path, *overrides: str) -> None:
        self.station = load_station(None, [f"recording.folder={folder}", *overrides])
        real = open_devices("sim", self.station)
        assert real.camera is not None and real.arm is not None and real.hand is not None
        self.camera, self.arm, self.hand = FaultyCamera(real.camera), FaultyArm(real.arm), FaultyHand(real.hand)
        for device in (self.camera, self.arm, self.hand):
            device.connect()
        self.robot = Robot(self.station)
        self.results: list[CycleResult] = []
        self.spoil: dict[str, Callable[[], None]] = {}
        self.actions = Actions(
            Equipment(
                self.camera, Guard(self.arm, self.station), self.hand, self.robot, self.station,
                open_models(self.station, {}),
            ),
            Gate(),
            real.presenter,
            lambda: set(self.station.nodes),
            lambda topic, message: None,
            lambda stage: self.spoil.get(stage, lambda: None)(),
            self.results.append,
        )  # fmt: skip

    def failure(self) -> CycleFailure:
        """Reset, and how the pick ends that follows."""
        self.actions.reset()
        self.actions.begin()
        with pytest.raises(CycleFailure) as caught:
            self.actions.pick()
        return caught.value


@pytest.fixture
def make_bench(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    """Makes benches, and closes their cameras: a graphics context left open keeps hundreds of megabytes."""
    with ExitStack() as stack:

        def make(*overrides: str) -> Bench:
            bench = Bench(tmp_path, *overrides)
            stack.callback(bench.camera.close)
            return bench

        yield make


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    return make_bench()


def _set(device: FaultyCamera | FaultyArm | FaultyHand, fault: Fault) -> Callable[[], None]:
    return lambda: setattr(device, "fault", fault)


def test_a_camera_that_sticks_in_mid_cycle_shows_no_second_look(bench: Bench) -> None:
    bench.spoil["execute"] = _set(bench.camera, Fault.STUCK)
    failure = bench.failure()
    assert failure.failure is Code.STALE_FRAME and "old frame" in failure.text


def test_a_camera_whose_frames_cannot_be_aborts_the_cell_and_the_field_is_named(bench: Bench) -> None:
    whole = bench.camera.capture

    def capture_rgba() -> Frame:
        frame = whole()
        return Frame(**{**dict(frame), "color": np.dstack([frame.color, frame.color[..., :1]])})

    bench.spoil["capture"] = lambda: setattr(bench.camera, "capture", capture_rgba)
    failure = bench.failure()
    assert failure.failure is Code.BAD_FRAME and "Frame.color" in failure.text and "RGBA" in failure.text


def test_a_camera_that_is_off_is_a_lost_device(bench: Bench) -> None:
    bench.spoil["capture"] = _set(bench.camera, Fault.OFF)
    assert bench.failure().failure is Code.DEVICE_LOST


def test_an_arm_that_goes_off_before_it_moves_is_a_lost_device(bench: Bench) -> None:
    bench.spoil["execute"] = _set(bench.arm, Fault.OFF)
    assert bench.failure().failure is Code.DEVICE_LOST


def test_the_guard_refuses_an_arm_that_says_nan(bench: Bench) -> None:
    bench.spoil["execute"] = _set(bench.arm, Fault.GARBAGE)
    failure = bench.failure()
    assert failure.failure is Code.MOTION_REFUSED and "not a finite number" in failure.text


def test_a_hand_that_does_not_open_on_the_way_keeps_the_arm_away_from_the_object(bench: Bench) -> None:
    bench.spoil["execute"] = _set(bench.hand, Fault.STUCK)
    bench.actions.restart_attempts(object_name="spatula")  # narrow: the hand comes fully open
    failure = bench.failure()
    assert failure.failure is Code.HAND_FAULT and "told to open" in failure.text
    tcp_m = bench.robot.base_from_tcp(bench.arm.state().q_rad)[2, 3]
    assert tcp_m > bench.station.planning.approach_m, "it is still above the approach line"


@pytest.mark.parametrize("fault", [Fault.GARBAGE, Fault.OFF])
def test_a_hand_without_a_possible_width_ends_the_cycle(bench: Bench, fault: Fault) -> None:
    bench.spoil["execute"] = _set(bench.hand, fault)
    assert bench.failure().failure is (Code.HAND_FAULT if fault is Fault.GARBAGE else Code.DEVICE_LOST)


def test_a_stop_is_not_confirmed_by_a_velocity_of_nan(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench("arm.rest_s=0.05")
    bench.arm.fault = Fault.GARBAGE
    with pytest.raises(CycleFailure, match="still moves"):
        bench.actions.stop(lambda wait_s: True)


def test_a_capture_needs_an_arm_that_knows_where_it_is_and_a_new_frame(bench: Bench) -> None:
    frame: Frame = capture(bench.camera, bench.arm, bench.robot).frame
    bench.camera.fault = Fault.STUCK
    with pytest.raises(StaleFrame):
        capture(bench.camera, bench.arm, bench.robot, newer_than_ns=frame.stamp_ns)
    bench.camera.fault, bench.arm.fault = Fault.NONE, Fault.GARBAGE
    with pytest.raises(DeviceLost, match="finite"):
        capture(bench.camera, bench.arm, bench.robot, newer_than_ns=frame.stamp_ns)
    assert np.isnan(bench.arm.state().q_rad).all()
