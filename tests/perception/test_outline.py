"""Closings on an outline alone: across what is long, on the wall of what is wide, never beyond the jaw."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from perception.rectangles.outline import Closing, Jaw, closings, rectangle_along

JAW = Jaw(opening_px=80, finger_px=20, room_px=10)
Mask = npt.NDArray[np.bool_]


def _bar(angle_deg: float, size: tuple[int, int] = (120, 30), at: tuple[int, int] = (160, 120)) -> Mask:
    mask = np.zeros((240, 320), np.uint8)
    return np.asarray(cv2.fillPoly(mask, [cv2.boxPoints((at, size, angle_deg)).astype(np.int32)], 1) > 0)


def _disc(radius: int, hole: int = 0) -> Mask:
    mask = cv2.circle(np.zeros((240, 320), np.uint8), (160, 120), radius, 1, -1)
    return np.asarray(cv2.circle(mask, (160, 120), hole, 0, -1) > 0) if hole else mask > 0


def _apart_deg(one: Closing, angle_deg: float) -> float:
    apart = abs(np.degrees(one.angle_rad) - angle_deg) % 180
    return float(min(apart, 180 - apart))


@pytest.mark.parametrize("angle_deg", [0, 20, 45, 70, 90, 135])
def test_a_bar_is_closed_on_across_its_middle(angle_deg: float) -> None:
    best = closings(_bar(angle_deg), JAW)[0]
    assert not best.is_rim and _apart_deg(best, angle_deg + 90) < 6
    assert best.run_px == pytest.approx(30, abs=3) and np.hypot(best.center_px[0] - 160, best.center_px[1] - 120) < 20


def test_a_ring_is_closed_on_at_its_wall_and_not_across_its_hole() -> None:
    best = closings(_disc(60, hole=48), JAW)[0]
    assert best.run_px == pytest.approx(12, abs=3)
    from_middle = np.array(best.center_px) - (160, 120)
    assert np.linalg.norm(from_middle) == pytest.approx(54, abs=4)
    assert _apart_deg(best, np.degrees(np.arctan2(from_middle[1], from_middle[0]))) < 10


def test_what_is_wider_than_the_jaw_is_closed_on_at_its_upper_rim() -> None:
    best = closings(_disc(80), JAW)[0]
    assert best.is_rim and best.center_px[1] < 50 and _apart_deg(best, 90) < 10


def test_what_fits_the_jaw_is_not_closed_on_at_its_rim() -> None:
    best = closings(_disc(20), JAW)[0]
    assert not best.is_rim and best.run_px == pytest.approx(40, abs=3)


@pytest.mark.parametrize("mask", [_bar(30), _disc(60, 48), _disc(80), _disc(25), _bar(0, (200, 70))])
def test_every_closing_fits_the_jaw_and_the_best_come_first(mask: Mask) -> None:
    found = closings(mask, JAW)
    assert found and all(one.run_px > 2 and one.run_px + 2 * JAW.room_px <= JAW.opening_px + 1e-6 for one in found)
    scores = [one.score for one in found]
    assert scores == sorted(scores, reverse=True) and scores[-1] >= 0 and scores[0] <= 1
    assert all(0 <= one.angle_rad <= np.pi for one in found)


def test_a_finger_does_not_go_where_there_is_no_room_for_it() -> None:
    """A fork whose two tines are too close for a finger between them is closed on across both."""
    fork = _bar(0, (150, 14), at=(160, 100)) | _bar(0, (150, 14), at=(160, 118)) | _bar(90, (32, 20), at=(80, 109))
    best = closings(fork, JAW)[0]
    assert best.run_px == pytest.approx(32, abs=4) and _apart_deg(best, 90) < 10


def test_nothing_has_no_closings() -> None:
    assert closings(np.zeros((40, 40), bool), JAW) == []


def test_a_rectangle_leaves_room_beside_the_contacts_and_is_as_high_as_a_finger_at_least() -> None:
    low, high = (
        rectangle_along(np.array([[10.0, 20.0], [14.0, 20.0]]), JAW),
        rectangle_along(np.array([[0.0, 0], [0, 50]]), JAW),
    )
    assert low.center_px == (12.0, 20.0) and low.width_px == pytest.approx(24) and low.height_px == 20
    assert high.width_px == pytest.approx(70) and high.height_px == pytest.approx(42)
    assert np.degrees(high.angle_rad) == pytest.approx(90)


def test_a_closing_s_rectangle_is_that_of_its_contacts() -> None:
    best = closings(_bar(30), JAW)[0]
    assert np.linalg.norm(best.ends_px()[1] - best.ends_px()[0]) == pytest.approx(best.run_px)
    assert best.rectangle(JAW).angle_rad == pytest.approx(best.angle_rad)
