"""Poses: built from unit quaternions only, inverted and applied as matrices are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus.transforms import (
    affine,
    angle_between_rad,
    apply,
    from_rotation,
    from_rotvec,
    from_translation,
    from_wxyz,
    inverse,
    to_rotvec,
    to_wxyz,
)

numbers = st.floats(-1.0, 1.0)
quaternions = st.tuples(numbers, numbers, numbers, numbers)
places = st.tuples(numbers, numbers, numbers)


@given(quaternions, places)
def test_a_pose_is_what_scipy_makes_of_it_to_the_last_bit(wxyz: tuple[float, ...], place_m: tuple[float, ...]) -> None:
    length = np.linalg.norm(wxyz)
    assume(length > 0.1)
    unit = np.array(wxyz) / length
    pose = from_wxyz(unit, place_m)
    assert np.array_equal(pose[:3, :3], Rotation.from_quat(unit, scalar_first=True).as_matrix())
    assert np.array_equal(pose[:, 3], [*place_m, 1.0])
    points = np.array([place_m, (1.0, 2.0, 3.0)])
    np.testing.assert_allclose(inverse(pose), np.linalg.inv(pose), atol=1e-12)
    np.testing.assert_allclose(apply(inverse(pose), apply(pose, points)), points, atol=1e-12)


@given(quaternions, places)
def test_a_pose_gives_its_quaternion_back(wxyz: tuple[float, ...], place_m: tuple[float, ...]) -> None:
    length = np.linalg.norm(wxyz)
    assume(length > 0.1)
    pose = from_wxyz(np.array(wxyz) / length, place_m)
    w, x, y, z = to_wxyz(pose)
    assert w >= 0 and math.hypot(w, x, y, z) == pytest.approx(1.0)
    np.testing.assert_allclose(from_wxyz((w, x, y, z), place_m), pose, atol=1e-12)


@given(quaternions, places)
def test_a_pose_gives_its_rotation_vector_back(wxyz: tuple[float, ...], place_m: tuple[float, ...]) -> None:
    assume(np.linalg.norm(wxyz) > 0.1)
    pose = from_wxyz(np.array(wxyz) / np.linalg.norm(wxyz), place_m)
    np.testing.assert_allclose(from_rotvec(to_rotvec(pose)), pose, atol=1e-12)


@given(places, st.floats(-math.pi, math.pi), quaternions)
def test_the_angle_between_two_poses_is_the_turn_between_them(
    axis: tuple[float, ...], turn_rad: float, wxyz: tuple[float, ...]
) -> None:
    assume(np.linalg.norm(axis) > 0.1 and np.linalg.norm(wxyz) > 0.1)
    turn = Rotation.from_rotvec(turn_rad * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    before = from_wxyz(np.array(wxyz) / np.linalg.norm(wxyz), (1.0, 2.0, 3.0))
    assert angle_between_rad(before, before @ from_rotation(turn, axis)) == pytest.approx(abs(turn_rad), abs=1e-7)


def test_a_turn_by_a_microradian_is_told_exactly() -> None:
    turn = from_rotation(Rotation.from_rotvec([0.0, 1e-6, 0.0]).as_matrix())
    assert angle_between_rad(np.eye(4), turn) == pytest.approx(1e-6, rel=1e-6)
    assert math.isnan(angle_between_rad(np.eye(4), np.full((4, 4), math.nan)))


def test_a_translation_alone_moves_and_does_not_turn() -> None:
    np.testing.assert_array_equal(apply(from_translation((1.0, 2.0, 3.0)), np.zeros(3)), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(from_translation((1.0, 2.0, 3.0))[:3, :3], np.eye(3))


def test_an_affine_map_may_scale_and_mirror() -> None:
    np.testing.assert_array_equal(apply(affine(np.diag([2.0, -1.0, 1.0]), (0.0, 0.0, 5.0)), np.ones(3)), [2, -1, 6])


@given(quaternions | st.tuples(*(st.floats(),) * 4))
def test_a_quaternion_of_another_length_is_refused(wxyz: tuple[float, ...]) -> None:
    length = math.hypot(*wxyz)
    if abs(length - 1) <= 0.9e-3:
        assert np.linalg.det(from_wxyz(wxyz)[:3, :3]) == pytest.approx(1.0)
    elif not abs(length - 1) <= 1.1e-3:
        with pytest.raises(ValueError, match="length 1"):
            from_wxyz(wxyz)


def test_what_is_no_quaternion_or_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="4 numbers"):
        from_wxyz((1.0, 0.0, 0.0))
    for bad in (math.nan, math.inf):
        with pytest.raises(ValueError, match="length 1"):
            from_wxyz((bad, 0.0, 0.0, 1.0))
        with pytest.raises(ValueError, match="finite"):
            from_wxyz((1.0, 0.0, 0.0, 0.0), (bad, 0.0, 0.0))
        with pytest.raises(ValueError, match="finite"):
            from_rotation(np.full((3, 3), bad))
