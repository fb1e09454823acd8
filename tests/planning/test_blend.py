"""Rounded corners: exact at the ends, smooth everywhere, and hardly off the path."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from planning.blend import CORNER_SHARE, blended
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot
from tests.planning.conftest import CAPTURE

TURNED = CAPTURE + np.array([0.8, 0.3, -0.4, 0.5, 0.6, -0.2, 1.2])
BACK = TURNED + np.array([-0.3, 0.2, 0.1, -0.4, 0.2, 0.5, 0.0])
TWO = [np.stack([CAPTURE, TURNED]), np.stack([TURNED, BACK])]


def off_polyline(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance (n,) of points from the polyline."""
    nearest = np.full(len(points), np.inf)
    for a, b in pairwise(corners):
        along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - along[:, None] * (b - a), axis=1))
    return nearest


@pytest.mark.parametrize("share", [0.0, 0.1, CORNER_SHARE])
def test_both_ends_are_exact(share: float) -> None:
    curve = blended(TWO, share)
    assert np.array_equal(curve.points_rad[0], CAPTURE)
    assert np.array_equal(curve.points_rad[-1], BACK)


def test_a_corner_is_cut_inside_its_triangle_and_the_rest_left_as_it_is() -> None:
    curve = blended(TWO)
    ((begin, end),) = curve.bends
    off = off_polyline(curve.points_rad, np.stack([CAPTURE, TURNED, BACK]))
    assert off[begin : end + 1].max() > 0.02
    assert off[:begin].max() < 1e-9
    assert off[end + 1 :].max() < 1e-9
    shorter = np.linalg.norm(BACK - TURNED)
    assert off.max() < CORNER_SHARE * shorter / 2


def test_a_smaller_share_cuts_less() -> None:
    off = [off_polyline(blended(TWO, share).points_rad, np.stack([CAPTURE, TURNED, BACK])).max()
           for share in (0.45, 0.25, 0.1, 0.02)]  # fmt: skip
    assert off == sorted(off, reverse=True)
    assert off[-1] < 0.01


def test_the_direction_turns_gradually() -> None:
    steps = np.diff(blended(TWO).points_rad, axis=0)
    directions = steps / np.linalg.norm(steps, axis=1)[:, None]
    turns = np.arccos(np.clip((directions[1:] * directions[:-1]).sum(axis=1), -1, 1))
    whole = np.arccos(
        (TURNED - CAPTURE) @ (BACK - TURNED) / np.linalg.norm(TURNED - CAPTURE) / np.linalg.norm(BACK - TURNED)
    )
    assert turns.sum() == pytest.approx(whole, rel=0.01)
    assert turns.max() < 0.06 * whole


def test_a_tcp_line_stays_straight_where_the_hand_works(robot: Robot) -> None:
    start = robot.base_from_tcp(CAPTURE)
    line = tcp_line(FR3_ARM, CAPTURE, start, np.array([0.0, 0.0, -0.10]))
    assert line is not None
    curve = blended([np.stack([CAPTURE - 0.3, CAPTURE]), line])
    poses = np.stack([robot.base_from_tcp(q) for q in curve.points_rad])
    last = poses[:, 2, 3] < start[2, 3] - 0.07
    aside_m = np.hypot(*(poses[last][:, :2, 3] - start[:2, 3]).T)
    assert last.sum() > 5
    assert aside_m.max() < 2e-4


def test_pieces_without_length_count_for_nothing() -> None:
    still = np.stack([TURNED, TURNED])
    assert np.allclose(blended([TWO[0], still, TWO[1]]).points_rad, blended(TWO).points_rad, atol=1e-12)


def test_being_there_already_is_one_point() -> None:
    curve = blended([np.stack([CAPTURE, CAPTURE])])
    assert curve.points_rad.shape == (1, 7)
    assert curve.bends == ()


def test_one_straight_piece_stays_straight() -> None:
    curve = blended(TWO[:1])
    assert off_polyline(curve.points_rad, TWO[0]).max() < 1e-12
    assert curve.bends == ()
