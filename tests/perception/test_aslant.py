"""One look that is taken aslant hides the back of things: how deep the fingers come down, and what the score says."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, Grasp
from cell.pick.detect import detect
from config.franka_hand import FINGER_TIP_M
from config.load import load_station
from perception.grasps.closing import weighted
from perception.models import open_models
from perception.scene.look import Look
from perception.scene.scene import Scene, scene_of
from tests.perception.from_aside import ABOVE, LEFT, RIGHT, Solid, look

STATION = load_station()
HIGH_M, WIDE_M = 0.08, 0.04
BOX = Solid((0.46, 0.0, 0.0), (WIDE_M, 0.05, HIGH_M))
WIDE = Solid((0.46, 0.0, 0.0), (0.072, 0.14, HIGH_M))
"""Beside its faces the opened jaw has 4 mm, and from the arm's side one of them is hidden."""
FROM_THE_ARM = (45.0, 180.0)


def _scene(solid: Solid, *directions: tuple[float, float]) -> Scene:
    return scene_of([Look.of(look([solid], one, noise_m=0.001), STATION) for one in directions], STATION)


@cache
def _detected(solid: Solid, tilt_deg: float) -> Detections:
    seen = look([solid], (tilt_deg, 135.0), noise_m=0.001)
    return detect([seen], STATION, open_models(STATION, {}))


def _tip_m(grasp: Grasp) -> float:
    return float(grasp.base_from_tcp[2, 3]) - FINGER_TIP_M


@pytest.mark.parametrize("tilt_deg", [20.0, 30.0, 40.0])
def test_the_pads_overlap_a_box_that_is_seen_aslant_as_deep_as_one_that_is_seen_from_above(tilt_deg: float) -> None:
    (best, *_) = _detected(BOX, tilt_deg).grasps
    assert HIGH_M - _tip_m(best) > 0.015
    assert best.width_m == pytest.approx(min(WIDE_M, 0.05), abs=0.014)


def test_the_hand_comes_wider_where_the_back_is_hidden() -> None:
    """Farther behind the box the camera sees lower."""
    usual_m = 2 * STATION.perception.approach_clearance_m
    (aslant, *_), (above, *_) = _detected(BOX, 40.0).grasps, _detected(BOX, 0.0).grasps
    assert aslant.opening_m > aslant.width_m + usual_m + 0.006
    assert above.opening_m == pytest.approx(above.width_m + usual_m)


@pytest.mark.parametrize("tilt_deg", [30.0, 40.0])
def test_no_finger_comes_down_where_the_camera_did_not_see(tilt_deg: float) -> None:
    heights = _scene(BOX, (tilt_deg, 135.0)).heights
    for grasp in _detected(BOX, tilt_deg).grasps:
        if grasp.base_from_tcp[2, 2] > -0.999:
            continue  # another level frame
        for x, y in _below_fingers_m(grasp.base_from_tcp, grasp.opening_m):
            (bound_m,) = heights.framed.bound_m[heights.cells(np.array([x]), np.array([y]))]
            assert bound_m < _tip_m(grasp) + 0.001


def _below_fingers_m(base_from_tcp: Transform, opening_m: float) -> np.ndarray:
    """Places (n, 2) in ``base`` below the middle of either opened finger."""
    out_m = opening_m / 2 + np.linspace(0.002, STATION.hand.finger_thickness_m - 0.002, 5)
    off_m = np.concatenate([out_m, -out_m])
    return np.asarray(base_from_tcp[:2, 3] + off_m[:, None] * base_from_tcp[:2, 1])


def test_behind_a_thing_may_be_anything_but_its_back_is_taken_for_upright() -> None:
    """The fingers keep off the space that was not seen; the pads look for the faces below the seen edges."""
    heights = _scene(BOX, LEFT).heights  # from the left, y > 0: the right is hidden
    behind = heights.cells(np.array([0.46]), np.array([-0.025 - 0.010]))
    assert heights.framed.bound_m[behind][0] > 0.05
    assert heights.framed.surface_m[behind][0] == 0.0


def test_only_one_look_that_leans_is_aslant() -> None:
    assert _scene(BOX, LEFT).is_aslant
    assert not _scene(BOX, ABOVE).is_aslant
    assert not _scene(BOX, LEFT, RIGHT).is_aslant
    assert "deep" in _detected(BOX, 30.0).grasps[0].terms
    assert "deep" not in _detected(BOX, 0.0).grasps[0].terms


def test_a_shallow_grasp_scores_far_less() -> None:
    terms = {"wide": np.ones(3), "deep": np.array([1.0, 0.5, 0.1])}
    deep, half, shallow = weighted(terms)
    assert deep == 1.0 and half > 0.8
    assert shallow < 0.5
    assert weighted({"wide": np.ones(1)})[0] == 1.0, "from above depth does not count"


def test_where_the_jaw_has_no_room_behind_a_thing_the_refusal_names_the_lean() -> None:
    with pytest.raises(CycleFailure) as refused:
        detect([look([WIDE], FROM_THE_ARM, noise_m=0.001)], STATION, open_models(STATION, {}))
    assert refused.value.failure is Code.NOT_SEEN
    leaning = re.search(r"leans by (\d+) degrees", refused.value.text)
    assert leaning is not None and abs(int(leaning[1]) - 45) <= 2


@pytest.mark.parametrize("direction", [(30.0, 90.0), (30.0, 120.0), (45.0, 120.0)])
def test_what_is_wider_than_the_jaw_has_no_narrow_corner(direction: tuple[float, float]) -> None:
    """Far from each other, the points of its near faces leave a ragged edge."""
    too_wide = Solid((0.46, 0.0, 0.0), (0.12, 0.09, 0.06))
    with pytest.raises(CycleFailure):
        detect([look([too_wide], direction, noise_m=0.001)], STATION, open_models(STATION, {}))
