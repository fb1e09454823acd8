"""``vlad_cell.detect``: arrays in, grasps out; what cannot be is refused with its name."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from vlad_cell import ConfigError, CycleFailure, Detections, Picture, detect

Array = npt.NDArray[Any]
SIZE_PX, HIGH_M, TALL_M = (360, 480), 0.6, 0.04
BOX_PX = np.s_[160:191, 200:284]
K = np.array([[450.0, 0.0, 240.0], [0.0, 450.0, 180.0], [0.0, 0.0, 1.0]])
BASE_FROM_CAMERA = np.array([[1, 0, 0, 0.45], [0, -1, 0, 0], [0, 0, -1, HIGH_M], [0, 0, 0, 1.0]])


def image() -> tuple[Array, Array]:
    """A blue box on a grey table, seen from straight above; 38 x 104 mm, 40 mm high."""
    color, depth_m = np.full((*SIZE_PX, 3), 165, np.uint8), np.full(SIZE_PX, HIGH_M, np.float32)
    color[BOX_PX], depth_m[BOX_PX] = (40, 90, 200), HIGH_M - TALL_M
    return color, depth_m


@pytest.fixture(scope="module")
def found() -> Detections:
    return detect(*image(), K, BASE_FROM_CAMERA)


def test_the_best_grasp_closes_across_the_narrow_side_from_above(found: Detections) -> None:
    best = found.grasps[0]
    approach, closing = best.base_from_grasp[:3, 2], best.base_from_grasp[:3, 1]
    assert best.width_m == pytest.approx(0.0385, abs=0.003)
    assert approach[2] < -0.98 and abs(closing[1]) > 0.98
    assert np.allclose(best.base_from_grasp[:2, 3], (0.45 + 0.003, 0.006), atol=0.02)
    assert 0 < best.base_from_grasp[2, 3] < TALL_M
    assert [one.score for one in found.grasps] == sorted((one.score for one in found.grasps), reverse=True)


def test_a_grasp_says_where_it_is_in_the_image_and_what_it_holds(found: Detections) -> None:
    best, (box,) = found.grasps[0], found.things
    u, v = np.rint(best.rectangle.center_px).astype(int)
    assert best.rectangle.corners_px().shape == (4, 2)
    assert found.labels[v, u] == best.thing == box.number
    assert np.allclose(box.size_m, (0.104, 0.0385, TALL_M), atol=0.005)
    assert found.goal_image.shape == (*SIZE_PX, 3)


def test_the_same_image_gives_the_same_grasps(found: Detections) -> None:
    again = detect(*image(), (450, 450, 240, 180), BASE_FROM_CAMERA.tolist())
    assert pickle.dumps(again.grasps[0].base_from_grasp) == pickle.dumps(found.grasps[0].base_from_grasp)


def test_a_picture_is_shown_by_a_notebook_and_saved(found: Detections, tmp_path: Path) -> None:
    picture = found.picture()
    assert picture._repr_png_().startswith(b"\x89PNG") and repr(picture) == "Picture(480 x 360 px)"
    assert picture.scaled(240).rgb.shape == (180, 240, 3)
    assert picture.save(tmp_path / "grasp.jpg").read_bytes().startswith(b"\xff\xd8")
    with pytest.raises(ConfigError, match="width_px is 0"):
        picture.scaled(0)
    with pytest.raises(ConfigError, match=r"grasp\.txt"):
        picture.save(tmp_path / "grasp.txt")
    with pytest.raises(ConfigError, match="cannot be written"):
        Picture(picture.rgb).save(tmp_path / "nowhere" / "grasp.png")


def test_a_hand_that_is_too_small_ends_with_the_reason() -> None:
    with pytest.raises(CycleFailure, match="jaw opens 20 mm") as refused:
        detect(*image(), K, BASE_FROM_CAMERA, settings={"hand.max_width_m": 0.02})
    assert refused.value.code == "NO_GRASP" and refused.value.advice


def test_a_coarse_image_in_which_nothing_is_found_is_not_called_empty() -> None:
    """Of 8 mm a pixel the bar has 50 pixels, too few to be told from noise."""
    color, depth_m = image()
    pinhole = K[[0, 1, 0, 1], [0, 1, 2, 2]] / 6
    with pytest.raises(CycleFailure, match="a thing of less than 62 x 62 mm is not noticed") as refused:
        detect(color[::6, ::6], depth_m[::6, ::6], pinhole, BASE_FROM_CAMERA)
    assert refused.value.code == "NOT_SEEN"


def test_nothing_outside_the_region_is_looked_at() -> None:
    with pytest.raises(CycleFailure) as refused:
        detect(*image(), K, BASE_FROM_CAMERA, region_m=(0.5, 0.58, 0.05, 0.12))
    assert refused.value.code == "NO_OBJECT"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"settings": {"hand.width": 1}}, r"Unknown key .* in settings\['hand\.width'\]\. Did you mean 'hand\."),
        ({"settings": {"hand.max_width_m": {0.08}}}, r"of set\. Correct settings\['hand\.max_width_m'\]"),
        ({"settings": {"hand.max_width_m": -1}}, r"greater than 0 .*Correct settings\['hand\.max_width_m'\]"),
        ({"region_m": (0.6, 0.3, -0.2, 0.2)}, r"scene\.pick_region_m: .*Correct region_m\."),
        ({"region_m": (0.3, 0.6)}, r"scene\.pick_region_m.*too few.*Correct region_m\."),
    ],
    ids=str,
)
def test_a_wrong_setting_is_refused_with_the_argument_that_gave_it(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        detect(*image(), K, BASE_FROM_CAMERA, **given)
