"""Inputs that cannot be are refused where they come in; what is half seen is not called seen. Scenes are made up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.codes import ADVICE, Code
from bus.errors import BadFrame, CycleFailure
from bus.messages import Detections, Frame, Observation, View
from bus.sensor_codec import frame_from_wire, frame_to_wire
from config.load import load_station
from perception.detector import detect, ignore_reply
from perception.geometry.inputs import checked
from perception.models import open_models
from tests.perception.conftest import BAR, Look

REGION = "scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]"
Change = Callable[[Any], Any]


def _detect(observation: Observation, *overrides: str) -> Detections:
    station = load_station(None, [REGION, *overrides])
    return detect(observation, station, open_models(station, {}), ignore_reply)


# --- what cannot be --------------------------------------------------------------------------------------------------


def _lens(**changes: Any) -> Change:
    return lambda camera: camera.model_copy(update=changes)


def _moved(*offset_m: float) -> Change:
    return lambda pose: pose + np.pad(np.array([offset_m]).T, ((0, 1), (3, 0)))


IMPOSSIBLE: dict[str, tuple[str, Change, str]] = {
    "depth of half the size": ("depth_m", lambda m: m[::2, ::2], "240 x 180 pixels, .*480 x 360"),
    "colour of half the size": ("color", lambda rgb: rgb[::2, ::2], "240 x 180 pixels, .*480 x 360"),
    "depth with a channel": ("depth_m", lambda m: m[..., None], r"got \(360, 480, 1\)"),
    "no pixels": ("depth_m", lambda m: m[:0], "480 x 0 pixels"),
    "RGBA": ("color", lambda rgb: np.dstack([rgb, rgb[..., :1]]), r"\(360, 480, 4\).*RGBA: leave the fourth away"),
    "grey": ("color", lambda rgb: rgb[..., 0], r"\(360, 480\).*grey: repeat it three times"),
    "grey with a channel": ("color", lambda rgb: rgb[..., :1], r"\(360, 480, 1\).*grey: repeat it three times"),
    "colour from 0 to 1": ("color", lambda rgb: rgb / 255.0, "float64, and RGB is of uint8"),
    "no picture": ("color", lambda rgb: rgb.tolist(), "expected an image"),
    "depth in millimetres": ("depth_m", lambda m: m * 1000, "600 m .*divide these millimetres by 1000"),
    "depth in whole millimetres": ("depth_m", lambda m: (m * 1000).astype(np.uint16), "divide these millimetres"),
    "metres taken for millimetres": ("depth_m", lambda m: m / 1000, "0.0006 m .*divided by 1000 twice"),
    "no focal length": ("color_camera", _lens(fx=0.0), "color_camera.fx is 0.0; it is a positive number of pixels"),
    "a negative focal length": ("depth_camera", _lens(fy=-450.0), "depth_camera.fy is -450.0; it is a positive"),
    "a focal length of NaN": ("color_camera", _lens(fx=float("nan")), "color_camera.fx is nan"),
    "an infinite centre": ("depth_camera", _lens(cx=float("inf")), "depth_camera.cx is inf; it is a finite number"),
    "three coefficients": ("color_camera", _lens(distortion=(0.1, 0.1, 0.1)), "a lens has 0, 4, 5, 8, 12, 14 finite"),
    "a coefficient of NaN": ("depth_camera", _lens(distortion=(float("nan"),) * 8), "depth_camera.distortion is"),
    "a mirrored depth camera": ("color_from_depth", lambda pose: pose @ np.diag([-1.0, 1, 1, 1]), "mirrors"),
    "a baseline in millimetres": ("color_from_depth", _moved(32.0, 0, 0), "32 m away, at most 1 m.*millimetres"),
    "a mirrored pose": ("base_from_color", lambda pose: pose @ np.diag([-1.0, 1, 1, 1]), "mirrors: .*-1, and \\+1"),
    "a pose of NaN": ("base_from_color", lambda pose: pose * np.nan, "not finite"),
    "a pose with a scale": ("base_from_color", lambda pose: pose @ np.diag([1.02, 1.02, 1.02, 1]), "not rigid"),
    "a skewed pose": ("base_from_color", lambda pose: pose + 0.01 * np.eye(4, k=1), "not rigid"),
    "a transposed pose": ("base_from_color", lambda pose: pose.T, "Is it transposed"),
    "a pose in millimetres": ("base_from_color", _moved(450.0, 0, 600.0), r"75\d.* m away, .*are these millimetres"),
    "a pose of three rows": ("base_from_color", lambda pose: pose[:3], r"got \(3, 4\)"),
    "enormous numbers": ("base_from_color", lambda pose: pose * 1e308, "not rigid"),
}
"""By name: the field of a `Frame` or a `View`, what is done to it, and what the error has to say."""

ROWS = pytest.mark.parametrize(("field", "change", "words"), IMPOSSIBLE.values(), ids=list(IMPOSSIBLE))


def _changed(seen: Observation, field: str, change: Change) -> tuple[Frame | View, dict[str, Any]]:
    whole: Frame | View = seen.view if field == "base_from_color" else seen.frame
    return whole, {field: change(getattr(whole, field))}


def _copied(seen: Observation, field: str, change: Change) -> Observation:
    """The observation with one field changed behind the checks, as ``model_copy`` does."""
    whole, changes = _changed(seen, field, change)
    return seen.model_copy(update={type(whole).__name__.lower(): whole.model_copy(update=changes)})


@ROWS
def test_what_cannot_be_is_refused_where_it_is_made(look: Look, field: str, change: Change, words: str) -> None:
    whole, changes = _changed(look([BAR]), field, change)
    with pytest.raises(BadFrame, match=words) as refused:
        type(whole)(**{**dict(whole), **changes})
    assert refused.value.text.startswith(f"{type(whole).__name__}.{field}"), "it names the field"
    assert refused.value.advice == ADVICE[Code.BAD_FRAME]


@ROWS
def test_a_copy_that_cannot_be_is_refused_by_the_check(look: Look, field: str, change: Change, words: str) -> None:
    with pytest.raises(CycleFailure, match=words) as refused:
        checked(_copied(look([BAR]), field, change))
    assert refused.value.failure is Code.BAD_FRAME


def test_what_is_sound_is_not_changed_by_the_check(look: Look) -> None:
    seen = look([BAR])
    again = checked(seen)
    assert again.frame.depth_m is seen.frame.depth_m and again.frame.color is seen.frame.color


def test_poses_of_single_precision_and_a_centre_outside_the_image_are_sound(look: Look) -> None:
    seen = look([BAR])
    turned = np.array([[0.6, 0.8, 0, 0.4], [0.8, -0.6, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1]], dtype=np.float32)
    cropped = seen.frame.color_camera.model_copy(update={"cx": -20.0})
    view = View(stamp_ns=1, arm=seen.view.arm, base_from_color=np.asarray(turned, dtype=float))
    checked(seen.model_copy(update={"view": view}))
    Frame(**{**dict(seen.frame), "color_camera": cropped})


def _holed(hole: float) -> Change:
    def change(depth_m: np.ndarray) -> np.ndarray:
        holed = depth_m.copy()
        holed[200:260, 300:400] = hole
        return holed

    return change


@pytest.mark.parametrize("hole", [-1.0, 0.0, -np.inf, np.inf])
def test_what_devices_write_for_nothing_measured_is_a_hole(look: Look, hole: float) -> None:
    frame = look([BAR]).frame
    depth_m = Frame(**{**dict(frame), "depth_m": _holed(hole)(frame.depth_m)}).depth_m
    np.testing.assert_array_equal(depth_m, _holed(np.nan)(frame.depth_m))


def test_a_frame_of_another_unit_is_refused_at_the_end_of_the_bus(look: Look) -> None:
    """Of a node in another language, whose depth image holds hundredths of a millimetre as if they were millimetres."""
    frame = look([BAR]).frame
    wire = frame_to_wire(frame.model_copy(update={"depth_m": frame.depth_m * 100}))
    with pytest.raises(BadFrame, match=r"60.* m .*divide"):
        frame_from_wire(wire)
