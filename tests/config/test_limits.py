"""The limit oracle: what it lets through, and what it says about the rest."""

from __future__ import annotations

import numpy as np
import pytest

from config.limits import (
    ACCELERATION_RAD_S2,
    JERK_RAD_S3,
    LOWER_RAD,
    UPPER_RAD,
    check,
    limit_shares,
    outside,
    position_share,
    velocity_bounds,
)

HOME = np.array([0.0, -0.55, 0.0, -2.1, 0.0, 1.55, 0.785])


def moved(joint: int, offsets_rad: list[float]) -> np.ndarray:
    """HOME, with ``offsets_rad`` added to ``joint`` (1..7) sample by sample."""
    q = np.tile(HOME, (len(offsets_rad), 1))
    q[:, joint - 1] += offsets_rad
    return q


def test_a_resting_arm_uses_only_its_position_range() -> None:
    report = check(np.tile(HOME, (5, 1)))
    assert report.ok
    assert report.worst[0] == "position"
    assert report.velocity.ratio == report.acceleration.ratio == report.jerk.ratio == 0.0


def test_one_sample_is_a_motion() -> None:
    assert check(HOME[None]).ok


def test_third_differences_are_judged_from_rest_to_rest() -> None:
    step = 1e-6
    report = check(moved(3, [0.0, step]))
    assert report.velocity.ratio == pytest.approx(step / 1e-3 / velocity_bounds(HOME)[1][2], rel=1e-6)
    assert report.acceleration.ratio == pytest.approx(step / 1e-6 / ACCELERATION_RAD_S2[2], rel=1e-6)
    assert report.jerk.ratio == pytest.approx(2 * step / 1e-9 / JERK_RAD_S3[2], rel=1e-6)
    assert report.jerk.joint == 3


def test_shares_are_signed_and_those_of_the_samples_begin_with_the_first() -> None:
    step = 1e-6
    used = limit_shares(moved(3, [0.0, -step, -step])).of_samples()
    assert all(rows.shape == (3, 7) for rows in used)
    np.testing.assert_array_equal(used.velocity[[0, 2]], 0.0)
    assert used.velocity[1, 2] == pytest.approx(step / 1e-3 / velocity_bounds(HOME)[0][2], rel=1e-6)
    assert used.acceleration[:, 2] * ACCELERATION_RAD_S2[2] == pytest.approx([0.0, -1.0, 1.0], abs=1e-6)


def test_the_middle_of_a_joint_s_range_is_a_share_of_zero() -> None:
    ends = position_share(np.stack([LOWER_RAD, (LOWER_RAD + UPPER_RAD) / 2, UPPER_RAD]))
    np.testing.assert_allclose(ends, np.repeat([[-1.0], [0.0], [1.0]], 7, axis=1), atol=1e-12)


def test_a_jump_is_named_with_kind_joint_and_time() -> None:
    report = check(moved(2, [0.0] * 10 + [1e-3] * 10))
    assert not report.ok
    assert report.worst[0] == "jerk"
    assert report.describe() == "The jerk of joint 2 at 0.011 s is over its limit: 40000.0 % of it."


def test_outside_the_range_is_a_position_violation() -> None:
    q = HOME.copy()
    q[3] = UPPER_RAD[3] + 1e-6
    report = check(q[None])
    assert not report.ok
    assert (report.worst[0], report.position.joint) == ("position", 4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite_is_never_ok(bad: float) -> None:
    q = np.tile(HOME, (4, 1))
    q[2, 5] = bad
    with np.errstate(invalid="ignore"):
        report = check(q)
    assert not report.ok
    assert "not within any limit" in report.describe()


def test_hardly_any_velocity_is_left_at_the_position_limit() -> None:
    for at, bound in ((UPPER_RAD, 1), (LOWER_RAD, 0)):
        assert np.abs(velocity_bounds(at)[bound]).max() < 0.05
    assert np.array_equal(velocity_bounds(UPPER_RAD + 0.1)[1], np.zeros(7)), "never negative: resting is allowed"
    lower, upper = velocity_bounds(np.stack([(LOWER_RAD + UPPER_RAD) / 2, HOME]))
    assert lower.shape == upper.shape == (2, 7)
    assert (lower < -1.0).all()
    assert (upper > 1.0).all()


@pytest.mark.parametrize(("q1_rad", "stricter"), [(2.1, "B"), (2.5, "A")])
def test_velocity_bounds_are_the_stricter_of_both_published_sets(q1_rad: float, stricter: str) -> None:
    q = HOME.copy()
    q[0] = q1_rad
    bounds = {"A": -0.30 + np.sqrt(12.0 * (2.7501 - q1_rad)), "B": -0.6599 + np.sqrt(12.0 * (2.9007 - q1_rad))}
    assert min(bounds, key=bounds.__getitem__) == stricter
    assert velocity_bounds(q)[1][0] == pytest.approx(bounds[stricter] - 1e-3, abs=1e-12)
    assert velocity_bounds(-q)[0][0] == pytest.approx(-bounds[stricter] + 1e-3, abs=1e-12)


def test_the_joint_that_leaves_its_range_is_named() -> None:
    q = np.stack([HOME, HOME])
    assert outside(q) is None
    assert outside(HOME) is None
    q[1, 3] = -0.1
    assert outside(q) == "joint 4 at -0.100 rad is outside its range -3.041..-0.153"
