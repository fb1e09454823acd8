"""Inputs that cannot be are refused where they come in; what is half seen is not called seen. Scenes are made up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import BadFrame, CycleFailure
from bus.messages import Detections, Frame, Grasp, Observation, View
from bus.messages.frame_checks import MADE_WRONG
from bus.sensor_codec import frame_from_wire, frame_to_wire
from bus.transforms import apply, inverse
from config.load import load_station
from logs.differences import compare
from perception.detector import detect, ignore_reply
from perception.geometry.inputs import checked
from perception.geometry.lift import project
from perception.models import open_models
from tests.perception.conftest import BAR, CAMERA, Box, Look

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
    assert refused.value.advice == MADE_WRONG, "whoever makes a frame need not have a cell to clear"


@ROWS
def test_a_copy_that_cannot_be_is_refused_by_the_check(look: Look, field: str, change: Change, words: str) -> None:
    with pytest.raises(CycleFailure, match=words) as refused:
        checked(_copied(look([BAR]), field, change))
    assert refused.value.failure is Code.BAD_FRAME and "cell clear" in refused.value.advice, "it ended a cycle"


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


# --- what is half seen: how detection has to answer -------------------------------------------------------------------
# These are of the detector, not of the door. What is cut by the image's border, or has no depth, lowers the score by a
# named term; space that was not seen is not free for a finger; what is refused says why.

SEEN_TERM = "seen"
"""Of a grasp's terms, the one that falls with what was not seen of the object, the fingers' and the palm's space."""
_OUTSIDE_M = 0.004
"""Half of a finger's thickness beyond the opening."""


def _code_and_text(observation: Observation, *overrides: str) -> tuple[Code | None, str]:
    try:
        _detect(observation, *overrides)
    except CycleFailure as failure:
        return failure.failure, str(failure)
    return None, ""


def _fingers_px(grasp: Grasp, seen: Observation) -> np.ndarray:
    """Pixels (2, 2) of both finger tips, opened, at the height of the grasp."""
    side_m = grasp.opening_m / 2 + _OUTSIDE_M
    tips = apply(grasp.base_from_tcp, np.array([[0.0, -side_m, 0.0], [0.0, side_m, 0.0]]))
    return project(apply(inverse(seen.view.base_from_color), tips), seen.frame.color_camera)


def _require_seen_fingers(seen: Observation, found: Detections) -> None:
    for grasp in found.grasps:
        for u, v in np.rint(_fingers_px(grasp, seen)).astype(int):
            assert 0 <= u < CAMERA.width and 0 <= v < CAMERA.height, "a finger outside the image"
            assert np.isfinite(seen.frame.depth_m[v, u]), "a finger where nothing was seen"


@ROWS
def test_detection_begins_with_the_check(look: Look, field: str, change: Change, words: str) -> None:
    with pytest.raises(CycleFailure, match=words) as refused:
        _detect(_copied(look([BAR]), field, change))
    assert refused.value.failure is Code.BAD_FRAME


def test_holes_that_were_copied_in_are_holes(look: Look) -> None:
    seen = look([BAR])
    by_sign, by_nan = (_detect(_copied(seen, "depth_m", _holed(hole))).grasps[0] for hole in (-1.0, np.nan))
    assert compare(by_sign, by_nan, {}) == []


@pytest.mark.parametrize("column", [0, 2, 6])
def test_no_finger_goes_beside_an_object_at_the_image_s_border(look: Look, column: int) -> None:
    """Its left face is cut by the border, or as near to it: whether a finger has room there, nobody has seen."""
    seen = look([Box((column, column + 24), (120, 240), 0.03, BAR.rgb)])
    code, text = _code_and_text(seen)
    if code is None:
        _require_seen_fingers(seen, _detect(seen))
    else:
        assert code is not Code.NO_OBJECT and text, "a refusal, and not an empty table"


def test_an_object_that_the_border_cuts_across_scores_less_by_a_named_term(look: Look) -> None:
    cut, whole = (_detect(look([Box((u, u + 90), (120, 144), 0.03, BAR.rgb)])).grasps[0] for u in (0, 190))
    assert cut.terms[SEEN_TERM] < whole.terms[SEEN_TERM] and cut.score < whole.score


@pytest.mark.parametrize("dark", [{"columns": (240, 290)}, {"rows": (112, 124)}], ids=["one end", "one side"])
def test_half_an_object_without_depth_scores_less_by_a_named_term(look: Look, dark: dict[str, Any]) -> None:
    """Beside the half without depth is no place for a finger: what colour shows there is the object."""
    bar = BAR._replace(columns=(190, 290))
    seen = look([bar, bar._replace(**dark, height_m=None)])
    code, text = _code_and_text(seen)
    if code is None:
        found, whole = _detect(seen), _detect(look([bar])).grasps[0]
        assert found.grasps[0].terms[SEEN_TERM] < whole.terms[SEEN_TERM] and found.grasps[0].score < whole.score
        _require_seen_fingers(seen, found)
    else:
        assert code is not Code.NO_OBJECT and text, "a refusal, and not an empty table"


def test_what_was_not_seen_is_not_free_for_a_finger(look: Look) -> None:
    """On both sides of the bar the table has no depth, wider than a finger is thick."""
    bar = BAR._replace(columns=(190, 290))
    holes = [Box((180, 300), rows, None, (165, 165, 165)) for rows in ((60, 99), (125, 164))]
    seen = look([*holes, bar])
    code, text = _code_and_text(seen)
    if code is None:
        _require_seen_fingers(seen, _detect(seen))
    else:
        assert code is not Code.NO_OBJECT and text, "a refusal, and not an empty table"


def test_an_object_half_outside_the_pick_region_is_taken_or_the_refusal_says_so(look: Look) -> None:
    """The bar lies from x = 0.25 to 0.37 m, and the region begins in its middle."""
    seen = look([BAR])
    region = "scene.pick_region_m=[0.31, 0.8, -0.3, 0.3]"
    code, text = _code_and_text(seen, region)
    if code is None:
        mask = _detect(seen, region).evidence.object_mask
        assert mask[112, 100] and mask[112, 170], "the object is whole, also beyond the region"
    else:
        assert "region" in text


@pytest.mark.parametrize("scale", [0.98, 1.02])
def test_depth_that_is_two_percent_off_is_said_or_grasped_where_it_is_seen(look: Look, scale: float) -> None:
    """The table seems to lie 12 mm higher or lower than the station says, and the object on it is 12 mm thick."""
    thin = BAR._replace(columns=(190, 290), height_m=0.012)
    seen = _copied(look([thin]), "depth_m", lambda m: m * np.float32(scale))
    code, text = _code_and_text(seen)
    if code is None:
        tips_m = _detect(seen).grasps[0].base_from_tcp[2, 3] - 0.0095
        table_m, top_m = 0.6 - 0.6 * scale, 0.6 - 0.588 * scale
        assert table_m < tips_m < top_m - 0.002, "above the table that is seen, and below the bar's top"
    else:
        assert "calibrat" in text.lower()
