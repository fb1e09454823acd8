"""Every alignment method that needs no other package, on an object whose true motion between two images is known."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks import alignment
from benchmarks.aligners import ALIGNERS, ALL, OPTIONAL
from benchmarks.aligners.optional import equal_sizes
from benchmarks.aligners.teaser import correspondences
from bus.codes import Code
from bus.errors import ConfigError, CycleFailure
from bus.messages import CameraModel
from bus.transforms import apply
from perception.align import METHODS, align
from perception.align.base import Shape
from perception.align.silhouette import outline

CAMERA = CameraModel(width=320, height=240, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
NOTHING = np.zeros((240, 320), dtype=bool)
OURS = tuple(name for name in ALIGNERS if name not in OPTIONAL)
GOOD = tuple(name for name in OURS if name != "pca_cfopt_printed")


def _shape(
    turn_deg: float = 0.0, scale: float = 1.0, shift_px: tuple[float, float] = (0, 0), rod: bool = False
) -> Shape:
    """A slab with a foot and a step in height, turned and scaled about the image's centre."""
    relief = np.zeros((240, 320), dtype=np.float32)
    cv2.rectangle(relief, (110, 95), (210, 125), 0.03, -1)
    cv2.rectangle(relief, (180, 125), (210, 165), 0.05, -1)
    move = cv2.getRotationMatrix2D((160, 120), -turn_deg, scale)
    move[:, 2] += shift_px
    relief = cv2.warpAffine(relief, move, (320, 240), flags=cv2.INTER_NEAREST)
    hidden = NOTHING.copy()
    if rod:
        hidden[:, 145:152] = True
    mask = (relief > 0) & ~hidden
    depth_m = np.where(mask, 0.6 - relief, np.nan).astype(np.float32)
    return Shape(mask, hidden, depth_m, CAMERA)


@settings(max_examples=20, deadline=None)
@given(st.floats(-180, 180), st.floats(0.7, 1.3), st.floats(-15, 15))
def test_silhouette_3d_undoes_a_turn_a_scale_and_a_shift(turn_deg: float, scale: float, shift_px: float) -> None:
    goal, observed = _shape(turn_deg, scale, (shift_px, -shift_px)), _shape()
    found = align("silhouette_3d", goal, observed)
    assert found.scale == pytest.approx(1 / scale, rel=0.05)
    assert found.residual < 0.08


@pytest.mark.parametrize("method", GOOD)
def test_an_object_that_stayed_is_left_where_it_is(method: str) -> None:
    found = align(method, _shape(rod=True), _shape(), methods=ALL)
    np.testing.assert_allclose(apply(found.observed_from_goal, _shape().points), _shape().points, atol=0.004)
    assert found.method == method and found.took_s > 0 and found.hypotheses >= 1


@pytest.mark.parametrize("method", METHODS)
def test_a_turned_object_is_turned_back(method: str) -> None:
    found = align(method, _shape(turn_deg=70), _shape())
    turn_deg = np.degrees(np.arctan2(found.observed_from_goal[1, 0], found.observed_from_goal[0, 0]))
    assert turn_deg == pytest.approx(-70, abs=3)


@pytest.mark.parametrize("method", GOOD)
def test_no_method_mirrors(method: str) -> None:
    assert np.linalg.det(align(method, _shape(turn_deg=130), _shape(), methods=ALL).observed_from_goal[:3, :3]) > 0


def test_the_formula_as_printed_lets_the_cloud_collapse() -> None:
    """Its scale carries metres; one-way distances reward it, two-way ones do not."""
    found = align("pca_cfopt_printed", _shape(), _shape(), methods=ALL)
    assert found.scale < 0.1 and found.observed_to_goal_m > 5 * found.goal_to_observed_m


@pytest.mark.parametrize("method", OURS)
def test_the_same_shapes_give_the_same_bits(method: str) -> None:
    one, other = (align(method, _shape(turn_deg=40), _shape(), methods=ALL) for _ in range(2))
    np.testing.assert_array_equal(one.observed_from_goal, other.observed_from_goal)


def test_another_object_leaves_a_residual_and_is_refused() -> None:
    bar = np.zeros((240, 320), np.uint8)
    cv2.rectangle(bar, (40, 115), (280, 125), 1, -1)
    other = Shape(bar > 0, NOTHING, np.where(bar > 0, 0.57, np.nan).astype(np.float32), CAMERA)
    with pytest.raises(CycleFailure) as failure:
        align("silhouette_3d", other, _shape(), max_residual=0.15)
    assert failure.value.failure is Code.MODEL_DRIFT


def test_a_goal_without_object_is_model_drift() -> None:
    empty = Shape(NOTHING, NOTHING, np.full((240, 320), np.nan, np.float32), CAMERA)
    with pytest.raises(CycleFailure) as failure:
        align("pca_cfopt", empty, _shape())
    assert failure.value.failure is Code.MODEL_DRIFT


def test_the_outline_closes_the_band_that_the_rod_hides() -> None:
    closed, whole = outline(_shape(rod=True)), _shape().mask
    assert (closed & whole).sum() / (closed | whole).sum() > 0.99


def test_a_method_of_another_package_turns_the_goal_back_and_equals_the_sizes() -> None:
    """The package is stood for by the true turn: what is ours is the way there and back."""
    goal, observed = _shape(turn_deg=70, scale=1.2), _shape()
    turn = Rotation.from_euler("z", -70, degrees=True).as_matrix()
    found = equal_sizes(goal, observed, lambda ours, theirs: (turn, theirs.mean(axis=0) - turn @ ours.mean(axis=0)))
    assert found.scale == pytest.approx(1 / 1.2, rel=0.05)
    np.testing.assert_allclose(apply(found.observed_from_goal, goal.points).mean(axis=0), observed.points.mean(axis=0))
    np.testing.assert_allclose(found.observed_from_goal[:3, :3], found.scale * turn)


def test_success_without_symmetries_is_counted_beside_the_other_and_a_missing_package_is_said() -> None:
    lines: list[str] = []
    figures = alignment.run("mild", 2, 0, tell=lines.append)
    assert all(figures[name]["success_strict"] <= figures[name]["success"] for name in ALIGNERS)
    assert set(figures["left_out"]) == set(ALL) - set(ALIGNERS)
    told = [line for line in lines if line.startswith(tuple(f"| {name} |" for name in ALIGNERS))]
    assert len(told) == len(ALIGNERS) and "100.0 %" in told[0]


def test_teaser_s_correspondences_are_blind_to_turns() -> None:
    cloud = np.random.default_rng(1).normal(size=(200, 3)) * [1.2, 0.7, 0.4]
    turn = Rotation.from_euler("xyz", [0.4, 0.2, 1.9]).as_matrix()
    order = np.random.default_rng(0).permutation(len(cloud))
    pairs = correspondences(cloud, (cloud @ turn.T)[order])
    assert len(pairs) > 60 and (order[pairs[:, 1]] == pairs[:, 0]).mean() > 0.9


@pytest.mark.parametrize("method", OPTIONAL)
def test_without_its_package_a_method_says_how_to_get_it(method: str) -> None:
    package = OPTIONAL[method]
    if package.is_here:
        pytest.skip(f"{package.name} is installed here")
    with pytest.raises(ConfigError, match=f"needs {re.escape(package.name)}") as refused:
        align(method, _shape(), _shape(), methods=ALL)
    assert refused.value.advice == package.advice
