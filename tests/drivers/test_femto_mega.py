"""The Femto Mega's driver against a camera on loopback, through the unmodified SDK."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from bus.errors import DriverUnavailable, StaleFrame
from bus.messages import Frame
from config.hardware import FemtoMegaSettings
from drivers.femto_mega.camera import FemtoMega
from drivers.femto_mega.clock import DeviceClock
from drivers.sim.optics import COLOR, COLOR_FROM_DEPTH, DEPTH
from stand_ins.femto_mega.device import SERIAL
from stand_ins.femto_mega.process import FakeFemtoMega, no_extensions
from stand_ins.femto_mega.scenery import _depth_mm


@pytest.fixture(scope="module")
def fake() -> Iterator[FakeFemtoMega]:
    no_extensions()
    with FakeFemtoMega("127.0.0.21") as fake:
        yield fake


@pytest.fixture
def camera(fake: FakeFemtoMega) -> Iterator[FemtoMega]:
    camera = FemtoMega(FemtoMegaSettings(address=fake.host, serial=SERIAL, extensions=no_extensions()))
    camera.connect()
    yield camera
    camera.close()


def captured(camera: FemtoMega, patience_s: float) -> Frame:
    """The first frame that comes, tried again and again."""
    give_up_s = time.monotonic() + patience_s
    while True:
        try:
            return camera.capture()
        except StaleFrame:
            assert time.monotonic() < give_up_s


def until(holds: Callable[[], bool], patience_s: float = 60.0) -> None:
    give_up_s = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < give_up_s
        time.sleep(0.02)


def test_the_calibration_is_what_the_camera_serves(camera: FemtoMega) -> None:
    frame = camera.capture()
    for got, served in ((frame.color_camera, COLOR), (frame.depth_camera, DEPTH)):
        assert (got.width, got.height) == (served.width, served.height)
        np.testing.assert_allclose(
            [got.fx, got.fy, got.cx, got.cy, *got.distortion],
            [served.fx, served.fy, served.cx, served.cy, *served.distortion],
            rtol=1e-6,
        )
    np.testing.assert_allclose(frame.color_from_depth, COLOR_FROM_DEPTH, atol=1e-6)


def test_depth_is_the_sensor_s_own_and_holes_are_nan(camera: FemtoMega) -> None:
    served_mm = _depth_mm()
    depth_m = camera.capture().depth_m
    assert np.array_equal(np.isnan(depth_m), served_mm == 0)
    np.testing.assert_allclose(depth_m[served_mm > 0], served_mm[served_mm > 0] / 1000, atol=1e-6)


def test_a_frame_is_exposed_after_it_was_asked_for_and_its_stamp_is_utc(camera: FemtoMega) -> None:
    for _ in range(5):
        asked_ns = time.time_ns()
        stamp_ns = camera.capture().stamp_ns
        assert asked_ns <= stamp_ns <= time.time_ns() + 10_000_000
    until(lambda: camera.capture().stamp_ns > 0 and camera.readings()["stamp_error_ms"] < 10)


def test_a_frozen_camera_is_a_stale_frame_soon(camera: FemtoMega, fake: FakeFemtoMega) -> None:
    fake.fault("freeze")
    started_s = time.monotonic()
    with pytest.raises(StaleFrame, match="cable"):
        camera.capture()
    assert time.monotonic() - started_s < 5.0
    fake.fault("thaw")
    captured(camera, patience_s=40)


def test_a_camera_that_was_unplugged_is_connected_again_by_itself(camera: FemtoMega, fake: FakeFemtoMega) -> None:
    fake.fault("die")
    with pytest.raises(StaleFrame):
        camera.capture()
    until(lambda: camera.readings() == {})
    fake.fault("live")
    captured(camera, patience_s=20)
    assert camera.readings()["reconnects"] >= 1


def test_a_jump_of_its_clock_is_noticed_and_stamps_are_right_again(camera: FemtoMega, fake: FakeFemtoMega) -> None:
    fake.fault("jump 3000000")
    until(lambda: camera.readings()["clock_jumps"] >= 1)
    asked_ns = time.time_ns()
    frame = captured(camera, patience_s=10)
    assert asked_ns <= frame.stamp_ns <= time.time_ns() + 50_000_000


def test_torn_pictures_are_never_used(camera: FemtoMega, fake: FakeFemtoMega) -> None:
    whole = camera.capture().color
    fake.fault("truncate 10")
    for _ in range(15):
        assert np.array_equal(captured(camera, patience_s=5).color, whole)


def test_lost_frames_are_counted(camera: FemtoMega, fake: FakeFemtoMega) -> None:
    before = camera.readings()["dropped_frames"]
    fake.fault("drop 4")
    until(lambda: camera.readings()["dropped_frames"] >= before + 3)


def test_it_reports_temperatures_and_rate(camera: FemtoMega) -> None:
    readings = camera.readings()
    assert readings["ir_temperature_c"] == pytest.approx(42.5) and readings["frames_per_s"] > 5


def test_another_serial_number_is_refused(fake: FakeFemtoMega) -> None:
    other = FemtoMega(FemtoMegaSettings(address=fake.host, serial="CL2X99999999", extensions=no_extensions()))
    with pytest.raises(DriverUnavailable, match=f"{SERIAL}, not CL2X99999999"):
        other.connect()


def test_nobody_at_the_address_is_said_at_once() -> None:
    no_extensions()
    started_s = time.monotonic()
    with pytest.raises(DriverUnavailable, match=r"No camera answers at 127\.0\.0\.22.*femto_mega\.address"):
        FemtoMega(FemtoMegaSettings(address="127.0.0.22", extensions=no_extensions())).connect()
    assert time.monotonic() - started_s < 10


def test_without_address_and_serial_it_asks_for_one() -> None:
    with pytest.raises(DriverUnavailable, match=r"Set femto_mega\.address or femto_mega\.serial"):
        FemtoMega(FemtoMegaSettings(extensions=no_extensions())).connect()


# --- its clock --------------------------------------------------------------------------------------------------------


def test_the_clock_is_known_after_ten_frames_and_maps_by_the_median() -> None:
    clock = DeviceClock()
    for index in range(12):
        assert clock.is_known == (index >= 10)
        wander_us = 300 if index % 3 == 0 else 0
        assert clock.hear(1000 * index, 5_000_000 + 1000 * index + wander_us, 5_000_000_000 + 1_000_000 * index)
    assert clock.host_ns(7000) == 5_007_000_000
    assert clock.error_ns == 1_150_000


@pytest.mark.parametrize("jump_us", [-5_000_000, 5_000_000])
def test_a_jump_is_told_and_what_was_learnt_is_forgotten(jump_us: int) -> None:
    clock = DeviceClock()
    for index in range(20):
        clock.hear(10_000_000 + 33_333 * index, 50_000_000 + 33_333 * index, 50_000_000_000 + 33_333_000 * index)
    assert not clock.hear(10_000_000 + 33_333 * 20 + jump_us, 0, 50_000_000_000 + 33_333_000 * 20)
    assert clock.jumps == 1 and not clock.is_known


def test_a_fit_by_which_frames_were_exposed_after_they_arrived_is_not_believed() -> None:
    clock = DeviceClock()
    for index in range(12):
        assert clock.hear(33_333 * index, 5_200_000 + 33_333 * index, 5_000_000_000 + 33_333_000 * index)
    assert clock.host_ns(0) <= 5_001_000_000


@pytest.mark.parametrize("fit_us", [-3_600_000_000, -6_000_000, 600_000, 3_600_000_000])
def test_a_fit_of_another_clock_is_told_like_a_jump(fit_us: int) -> None:
    clock = DeviceClock()
    assert clock.hear(1000, 0, 5_000_000_000)
    assert not clock.hear(2000, 5_001_000 + fit_us, 5_001_000_000)
    assert not clock.is_known
