"""The yardstick of images taken aslant: where the camera stands, how deep a grasp is, and what is printed."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.aslant.run import REFUSED, Row, figures
from benchmarks.aslant.scenes import looking
from benchmarks.heaps.heap import Part
from benchmarks.heaps.judge import TRUE, Judge
from benchmarks.heaps.shapes import box_corners
from bus.transforms import from_rotation
from config.devices import HandSettings
from config.franka_hand import FINGER_TIP_M

BOX = Part(box_corners(np.array([0.06, 0.04, 0.08]), np.array([0.0, 0.0, 0.04])), 0)
DOWN = np.diag([1.0, -1.0, -1.0])


def _from_above(tip_m: float) -> np.ndarray:
    return from_rotation(DOWN, (0.0, 0.0, tip_m + FINGER_TIP_M))


def test_the_camera_leans_by_its_tilt_and_looks_at_the_thing() -> None:
    at = np.array([0.5, 0.1, 0.03])
    base_from_camera = looking(at, np.radians(30), np.radians(70), 0.6)
    assert np.degrees(np.arccos(-base_from_camera[2, 2])) == pytest.approx(30)
    np.testing.assert_allclose(base_from_camera @ [0, 0, 0.6, 1], [*at, 1])
    assert np.linalg.det(base_from_camera[:3, :3]) == pytest.approx(1)


def test_the_overlap_is_how_far_the_pads_reach_down_beside_the_thing() -> None:
    judge = Judge([BOX], np.eye(4), HandSettings())
    for deep_m in (0.005, 0.020):
        overlap_m, edge_m = judge.overlap_m(_from_above(0.08 - deep_m), 0.07)
        assert overlap_m == pytest.approx(deep_m, abs=0.0025)  # the judge's lines are so far apart
        assert edge_m == pytest.approx(0.08, abs=0.0025)
    assert judge.overlap_m(_from_above(0.09), 0.07) == (0.0, 0.0)


def test_shares_are_of_the_feasible_scenes_and_shallow_grasps_are_told_apart() -> None:
    rows = [
        Row(30.0, TRUE, True, 100.0, score=0.9, overlap_m=0.020, depth=0.9),
        Row(30.0, TRUE, True, 100.0, score=0.4, overlap_m=0.004, depth=0.2),
        Row(30.0, REFUSED, True, 100.0, "NOT_SEEN"),
        Row(30.0, REFUSED, False, 100.0, "NO_GRASP"),
        Row(0.0, TRUE, True, 100.0, score=0.9, overlap_m=0.020, depth=1.0),
    ]
    told = figures(rows)
    assert list(told) == ["0", "30"]
    aslant = told["30"]
    assert (aslant["scenes"], aslant["feasible"], aslant["true_grasp"]) == (4, 3, 0.6667)
    assert aslant["outcomes"] == {TRUE: 2, "NOT_SEEN": 1}
    assert aslant["shallow"] == 0.5 and aslant["score"] == {"shallow": 0.4, "others": 0.9}
