"""Poses: built from unit quaternions only, inverted and applied as matrices are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus.transforms import apply, from_rotation, from_wxyz, inverse

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
