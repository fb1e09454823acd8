"""Hand-eye calibration from synthetic views with noise, and what it refuses."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus.errors import CalibrationError
from config.calibration import MARKERS, CalibrationSettings
from config.charuco import board_image, charuco_board
from drivers.sim.optics import COLOR
from perception.hand_eye import (
    Sighting,
    corners_in_color,
    corrected,
    hand_eye,
    off_px,
    sight,
)

SETTINGS = CalibrationSettings()
CORNERS_M = np.asarray(charuco_board(SETTINGS).getChessboardCorners(), dtype=float)


def pose(turn_deg: tuple[float, float, float], position_m: tuple[float, float, float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    matrix[:3, 3] = position_m
    return matrix


HAND_FROM_COLOR = pose((2.0, -3.0, 91.0), (0.07, 0.01, 0.03))
BASE_FROM_BOARD = pose((180.0, 0.0, 20.0), (0.45, 0.05, 0.0))


def views(
    seed: int,
    noise_px: float,
    count: int = 15,
    spread_deg: float | tuple[float, float, float] = 25.0,
    *,
    arm_mm: float = 0.0,
    half_turns: bool = False,
) -> list[Sighting]:
    """The board from ``count`` directions, turned by up to ``spread_deg`` about each axis.

    Args:
        arm_mm: by how much the hand is not where the arm says. ``half_turns``: every other view stands on its head.
    """
    rng = np.random.default_rng(seed)
    matrix = np.array([[COLOR.fx, 0, COLOR.cx], [0, COLOR.fy, COLOR.cy], [0, 0, 1]])
    middle = CORNERS_M.mean(axis=0)
    sightings = []
    for index in range(count):
        turn = Rotation.from_rotvec(np.deg2rad(rng.uniform(-1.0, 1.0, 3) * spread_deg)).as_matrix()
        turn = np.diag([-1.0, -1.0, 1.0]) @ turn if half_turns and index % 2 else turn
        color_from_board = np.eye(4)
        color_from_board[:3, :3] = turn
        color_from_board[:3, 3] = np.array([0.0, 0.0, rng.uniform(0.4, 0.55)]) - turn @ middle
        rotation, _ = cv2.Rodrigues(turn)
        pixels, _ = cv2.projectPoints(CORNERS_M, rotation, color_from_board[:3, 3], matrix, np.array(COLOR.distortion))
        base_from_hand = BASE_FROM_BOARD @ np.linalg.inv(HAND_FROM_COLOR @ color_from_board)
        base_from_hand[:3, 3] += arm_mm / 1e3 * rng.normal(size=3)
        noisy = pixels[:, 0] + rng.normal(0.0, noise_px, (len(CORNERS_M), 2))
        sightings.append(Sighting(base_from_hand, CORNERS_M, noisy))
    return sightings


def apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    turn = Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).magnitude()
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]) * 1e3), float(np.rad2deg(turn))


def test_without_noise_it_is_exact() -> None:
    found = hand_eye(views(1, 0.0), COLOR)
    assert apart(found.hand_from_color, HAND_FROM_COLOR) < (1e-3, 1e-3)
    assert apart(found.base_from_board, BASE_FROM_BOARD) < (1e-3, 1e-3)
    assert found.rms_px < 1e-4 and found.spread_mm < 1e-2


@settings(max_examples=3)
@given(seed=st.integers(0, 10_000))
def test_with_a_third_of_a_pixel_of_noise_it_is_right_to_half_a_millimetre(seed: int) -> None:
    found = hand_eye(views(seed, 0.33), COLOR)
    off_mm, off_deg = apart(found.hand_from_color, HAND_FROM_COLOR)
    assert off_mm < 0.5 and off_deg < 0.3
    assert 0.3 < found.rms_px < 0.6 and len(found.views_px) == 15
    assert 0.02 < found.uncertainty_mm < 0.5 and 0.002 < found.uncertainty_deg < 0.3


def test_a_few_wrong_corners_do_not_carry_it_away() -> None:
    sightings = views(3, 0.2)
    pixels = sightings[4].pixels.copy()
    pixels[:2] += 40.0
    sightings[4] = Sighting(sightings[4].base_from_hand, sightings[4].board_m, pixels)
    found = hand_eye(sightings, COLOR)
    assert apart(found.hand_from_color, HAND_FROM_COLOR)[0] < 1.0
    assert int(np.argmax(found.views_px)) == 4, "the report names the bad view"


def test_too_few_views_are_refused() -> None:
    with pytest.raises(CalibrationError, match="7 views; 8 are needed"):
        hand_eye(views(1, 0.0, count=7), COLOR)


TELL_NOTHING = {
    "one place": views(1, 0.2, spread_deg=0.0),
    "one direction": views(1, 0.2, spread_deg=2.0),
    "about the view only": views(1, 0.2, spread_deg=(0.0, 0.0, 40.0)),
    "about one oblique axis only": views(1, 0.2, spread_deg=(0.0, 30.0, 0.0)),
    "two nearly parallel axes": views(1, 0.2, spread_deg=(2.0, 30.0, 2.0)),
    "half turns": views(1, 0.2, spread_deg=0.0, half_turns=True),
    "half turns about a leaning axis": views(1, 0.2, spread_deg=(0.0, 0.0, 30.0), half_turns=True),
    "two places": views(1, 0.2, count=2) * 6,
    "half turns about three axes": [
        Sighting(one.base_from_hand @ np.diag([*signs, 1.0]), one.board_m, one.pixels)
        for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])
        for one in views(1, 0.2, count=1) * 3
    ],
}


@pytest.mark.parametrize("sides", TELL_NOTHING)
def test_views_without_turns_about_two_axes_are_refused(sides: str) -> None:
    with pytest.raises(CalibrationError, match="about a second axis"):
        hand_eye(TELL_NOTHING[sides], COLOR)


def test_one_view_alone_from_another_side_is_not_believed() -> None:
    sightings = [*views(1, 0.3, count=11, spread_deg=(1.0, 30.0, 1.0), arm_mm=0.3), *views(2, 0.3, count=1)]
    with pytest.raises(CalibrationError, match="uncertain by"):
        hand_eye(sightings, COLOR)


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(8, 20),
    spread_deg=st.tuples(*(st.floats(0.0, 40.0),) * 3),
    noise_px=st.floats(0.05, 0.6),
    arm_mm=st.sampled_from([0.0, 0.3]),
    half_turns=st.booleans(),
)
def test_a_result_is_as_right_as_it_says_or_refused(
    seed: int, count: int, spread_deg: tuple[float, float, float], noise_px: float, arm_mm: float, half_turns: bool
) -> None:
    sightings = views(seed, noise_px, count, spread_deg, arm_mm=arm_mm, half_turns=half_turns)
    try:
        found = hand_eye(sightings, COLOR)
    except CalibrationError:
        return
    off_mm, off_deg = apart(found.hand_from_color, HAND_FROM_COLOR)
    assert off_mm < 5 * found.uncertainty_mm < 7.5
    assert off_deg < 5 * found.uncertainty_deg < 1.5


def test_the_check_tells_a_right_calibration_from_one_that_is_off() -> None:
    sightings = views(5, 0.2)
    right_px = off_px(sightings, COLOR, HAND_FROM_COLOR).mean()
    assert right_px < 0.3
    shifted = HAND_FROM_COLOR @ pose((0.0, 1.0, 0.0), (0.006, 0.0, 0.0))
    assert off_px(sightings, COLOR, shifted).mean() > 4 * right_px
    found = corrected(sightings[::3], COLOR, shifted)
    assert apart(found.hand_from_color, HAND_FROM_COLOR)[0] < 5 * found.uncertainty_mm < 5.0


def test_a_check_from_one_side_says_that_it_cannot_tell() -> None:
    along_the_axis = HAND_FROM_COLOR @ pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    sightings = views(5, 0.2, spread_deg=(0.0, 0.0, 40.0))
    with pytest.raises(CalibrationError, match="about a second axis"):
        corrected(sightings, COLOR, along_the_axis)
    with pytest.raises(CalibrationError, match="about a second axis"):
        corrected(sightings[:1], COLOR, HAND_FROM_COLOR)


def test_the_printed_board_is_found_in_a_picture_and_a_blank_one_is_none() -> None:
    image = board_image(SETTINGS, 2000.0)
    color = np.full((720, 1280, 3), 255, np.uint8)
    color[100 : 100 + len(image), 300 : 300 + image.shape[1]] = image[..., None]
    seen = sight(color, np.eye(4), SETTINGS)
    assert seen is not None and len(seen.pixels) == len(CORNERS_M)
    expected_px = seen.board_m[:, :2] * 2000.0 + (300, 100)
    assert np.abs(seen.pixels - expected_px).max() < 1.5
    assert sight(np.full_like(color, 255), np.eye(4), SETTINGS) is None


def test_corners_get_their_depth_from_the_board_s_pose() -> None:
    (sighting,) = views(2, 0.0, count=1)
    _, depth_m = corners_in_color(sighting, COLOR)
    color_from_board = np.linalg.inv(sighting.base_from_hand @ HAND_FROM_COLOR) @ BASE_FROM_BOARD
    np.testing.assert_allclose(depth_m, (CORNERS_M @ color_from_board[:3, :3].T + color_from_board[:3, 3])[:, 2],
                               atol=1e-5)  # fmt: skip


@pytest.mark.parametrize("dictionary", sorted(MARKERS))
def test_every_dictionary_that_may_be_chosen_makes_a_board_of_all_its_markers(dictionary: str) -> None:
    columns = MARKERS[dictionary] * 2 // 8
    assert len(charuco_board(CalibrationSettings(dictionary=dictionary, squares=(8, min(columns, 7)))).getIds()) > 0
    number = getattr(cv2.aruco, dictionary)
    assert len(cv2.aruco.getPredefinedDictionary(number).bytesList) == MARKERS[dictionary]
