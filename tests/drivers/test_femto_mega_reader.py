"""The Femto Mega's reader: odd frames, silence, a hanging SDK, and the end that nobody foresaw."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import DeviceLost, DriverUnavailable, StaleFrame
from bus.threads import handled_by
from config.hardware import FemtoMegaSettings
from drivers.femto_mega.camera import FemtoMega
from drivers.femto_mega.session import Pair, TornFrame, pair_of
from drivers.rate import Rate
from stand_ins.orbbec import JPEG, FakeOrbbec

Odd = Callable[[Pair], Pair | None]
SETTINGS = FemtoMegaSettings(address="127.0.0.1", settle_frames=1, lost_after_s=0.21)


@contextmanager
def connected(orbbec: FakeOrbbec, **settings: Any) -> Iterator[FemtoMega]:
    camera = FemtoMega(SETTINGS.model_copy(update=settings), orbbec.open)
    camera.connect()
    try:
        yield camera
    finally:
        orbbec.goes_on.set()
        camera.close()


def shortest_s(error: type[Exception], act: Callable[[], object]) -> float:
    """How long ``act`` takes to raise, the shortest of three times: a busy machine is not late every time."""

    def lasting_s() -> float:
        started_s = time.monotonic()
        with pytest.raises(error):
            act()
        return time.monotonic() - started_s

    return min(lasting_s() for _ in range(3))


def until(holds: Callable[[], bool], patience_s: float = 60.0, told: Callable[[], object] = lambda: "") -> None:
    """Wait; ``told`` says what there is instead when it never holds."""
    give_up_s = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < give_up_s, told()
        time.sleep(0.002)


def raising(error: Exception) -> Odd:
    def odd(_: Pair) -> Pair:
        raise error

    return odd


def changed(**values: Any) -> Odd:
    return lambda pair: replace(pair, **values)


TORN: dict[str, Odd] = {
    "depth of another size": changed(depth_mm=np.ones((2, 2), np.uint16)),
    "depth without rows": changed(depth_mm=np.ones(48, np.uint16)),
    "depth of another type": changed(depth_mm=np.ones((6, 8), np.float32)),
    "no depth": changed(depth_mm=None),
    "depth without a scale": changed(scale_mm=float("nan")),
    "no time": changed(device_us=0),
    "no number": changed(number=None),
    "half a picture": changed(jpeg=JPEG[: len(JPEG) // 2]),
    "an empty picture": changed(jpeg=b""),
    "no picture": changed(jpeg=None),
    "another format": changed(jpeg=bytes(96)),
    "a buffer of odd length": raising(ValueError("buffer size must be a multiple of element size")),
    "no buffer": raising(TypeError("a bytes-like object is required, not 'NoneType'")),
    "no frame in the set": raising(AttributeError("'NoneType' object has no attribute 'get_index'")),
    "a torn frame": raising(TornFrame("a frame cannot be read")),
}


@pytest.mark.parametrize("torn", TORN)
def test_frames_that_cannot_be_used_are_counted_and_the_next_good_one_is_taken(torn: str) -> None:
    orbbec = FakeOrbbec()
    with connected(orbbec, lost_after_s=30.0) as camera:
        orbbec.odd.extend([TORN[torn]] * 3)
        until(lambda: camera.readings()["broken_frames"] >= 3, told=camera.readings)
        assert camera.capture().depth_m.shape == (6, 8)
        assert camera.readings()["broken_frames"] == 3, "the good one after them is not another"
        assert camera.readings()["reconnects"] == 0


@pytest.mark.parametrize("always", ["half a picture", "a buffer of odd length", "depth of another size"])
def test_a_camera_that_gives_nothing_else_is_connected_anew(always: str) -> None:
    orbbec = FakeOrbbec()
    with connected(orbbec) as camera:
        orbbec.always = TORN[always]
        with pytest.raises(StaleFrame, match="connected anew by itself"):
            camera.capture()
        until(lambda: orbbec.closed >= 1)
        orbbec.always = None
        until(lambda: orbbec.sessions >= 2)
        until(lambda: camera.readings().get("reconnects", 0) >= 1)
        assert _captured(camera).depth_m.shape == (6, 8)


def _captured(camera: FemtoMega) -> Any:
    give_up_s = time.monotonic() + 60
    while time.monotonic() < give_up_s:
        try:
            return camera.capture()
        except StaleFrame:
            continue
    raise AssertionError("no frame came")


@pytest.mark.parametrize("silence", [lambda _: None, raising(RuntimeError("the stream was lost"))])
def test_silence_and_a_lost_stream_are_connected_anew(silence: Odd) -> None:
    orbbec = FakeOrbbec()
    with connected(orbbec) as camera:
        orbbec.always, orbbec.refusing = silence, DriverUnavailable("No camera answers.", "Check it.")
        until(lambda: orbbec.closed >= 1)
        until(lambda: camera.readings() == {})
        orbbec.always = orbbec.refusing = None
        _captured(camera)
        assert camera.readings()["reconnects"] == 1


def test_a_camera_that_cannot_fix_its_exposure_is_connected_anew() -> None:
    orbbec = FakeOrbbec()
    orbbec.fixing = RuntimeError("Send control transfer failed!")
    camera = FemtoMega(SETTINGS.model_copy(update={"fixed_exposure": True}), orbbec.open)

    def once(pair: Pair) -> Pair:
        if orbbec.closed:
            orbbec.fixing = None
        return pair

    orbbec.always = once
    camera.connect()
    assert orbbec.sessions == 2 and camera.readings()["reconnects"] == 1
    camera.close()


def test_a_picture_that_looks_whole_and_does_not_decode_is_not_waited_for_in_vain() -> None:
    orbbec = FakeOrbbec()
    with connected(orbbec) as camera:
        orbbec.always = changed(jpeg=b"\xff\xd8xx\xff\xd9")
        with pytest.raises(StaleFrame, match="does not decode"):
            camera.capture()
        assert camera.readings()["broken_frames"] > 1
        orbbec.always = None
        camera.capture()


def test_a_camera_that_repeats_itself_gives_no_frame() -> None:
    orbbec = FakeOrbbec()
    with connected(orbbec) as camera:
        kept: list[Pair] = []

        def again(pair: Pair) -> Pair:
            kept.append(pair)
            return replace(kept[0], arrived_ns=pair.arrived_ns, heard_ns=pair.heard_ns)

        orbbec.always = again
        until(lambda: len(kept) >= 2)  # the first one was new
        with pytest.raises(StaleFrame, match=r"repeats a frame|only frames that cannot be used"):
            camera.capture()


def test_a_hanging_sdk_is_a_stale_frame_in_time() -> None:
    orbbec = FakeOrbbec()
    with connected(orbbec) as camera:
        orbbec.goes_on.clear()
        started_s = time.monotonic()
        with pytest.raises(StaleFrame):
            camera.capture()
        assert time.monotonic() - started_s < 10, "the SDK hangs for a minute"


def test_an_end_that_nobody_foresaw_is_told_and_the_camera_lost_until_it_is_connected_again() -> None:
    orbbec, told = FakeOrbbec(), []
    with handled_by(lambda name, defect: told.append((name, repr(defect)))), connected(orbbec) as camera:
        orbbec.odd.append(raising(KeyError("unforeseen")))
        until(lambda: bool(told))
        assert told == [("camera-read", "KeyError('unforeseen')")] and orbbec.closed == 1
        with pytest.raises(DeviceLost, match="defect"):
            camera.capture()
        assert shortest_s(DeviceLost, camera.capture) < 0.2 and camera.readings()["frames_per_s"] == 0
        camera.connect()
        camera.capture()


@pytest.mark.parametrize("step_s", [-3600.0, -0.3, 0.3, 3600.0])
def test_a_step_of_the_wall_clock_loses_no_frame_and_shows_only_in_the_stamps(step_s: float) -> None:
    orbbec = FakeOrbbec()
    with connected(orbbec, lost_after_s=30.0) as camera:
        orbbec.utc_step_ns = round(step_s * 1e9)
        for _ in range(3):
            asked_ns, number = orbbec.utc_ns(), orbbec.number
            stamp_ns = camera.capture().stamp_ns
            assert asked_ns <= stamp_ns <= orbbec.utc_ns() and orbbec.number > number
        readings = camera.readings()
        assert readings["clock_jumps"] == readings["reconnects"] == 0 and readings["stamp_error_ms"] < 5


def test_the_rate_is_of_the_last_seconds() -> None:
    rate = Rate()
    for tick in range(100):
        rate.count(tick / 30)
    assert rate.hz(100 / 30) == pytest.approx(30, abs=1)
    assert rate.hz(100 / 30 + 1) == pytest.approx(15, abs=1)
    assert rate.hz(100 / 30 + 3) == 0


# --- what the SDK hands over ------------------------------------------------------------------------------------------


def frames(**odd: Any) -> Any:
    """A frame set as the SDK's, with some of its answers changed."""
    said = {"height": 6, "width": 8, "index": 4, "timestamp_us": 7, "global_timestamp_us": 0, "depth_scale": 1.0}
    said |= {"data": np.zeros(96, np.uint8)} | odd
    depth = SimpleNamespace(**{f"get_{name}": (lambda value=value: value) for name, value in said.items()})
    color = SimpleNamespace(get_data=lambda: np.frombuffer(JPEG, np.uint8))
    return SimpleNamespace(get_depth_frame=lambda: depth, get_color_frame=lambda: color)


def test_a_whole_frame_set_is_copied_out_and_half_a_one_is_none() -> None:
    pair = pair_of(frames())
    assert pair is not None and pair.depth_mm.shape == (6, 8) and pair.jpeg == JPEG
    assert pair_of(SimpleNamespace(get_depth_frame=lambda: None, get_color_frame=lambda: 1)) is None


@given(st.binary(max_size=200).filter(lambda data: len(data) != 96))
def test_a_depth_buffer_of_any_other_size_is_a_torn_frame(data: bytes) -> None:
    with pytest.raises(TornFrame):
        pair_of(frames(data=np.frombuffer(data, np.uint8)))


@pytest.mark.parametrize(
    "odd",
    [
        {"data": np.zeros(95, np.uint8)},
        {"data": np.zeros(94, np.uint8)},
        {"data": np.zeros(0, np.uint8)},
        {"data": None},
        {"index": None},
        {"timestamp_us": None},
        {"depth_scale": "metre"},
        {"width": 0},
        {"height": -6, "width": -8},
    ],
    ids=str,
)
def test_one_that_is_not_what_it_should_be_is_a_torn_frame(odd: dict[str, Any]) -> None:
    with pytest.raises(TornFrame, match="cannot be read"):
        pair_of(frames(**odd))
