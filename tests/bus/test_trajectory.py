"""The moving average: exact ends, bounded derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from bus.trajectory import TICK_S, Trajectory, moving_average


def _ramp(samples: int, acceleration: float) -> np.ndarray:
    """All joints speed up and brake again at ``acceleration`` [rad/s^2]."""
    signs = np.concatenate([np.ones(samples), -np.ones(samples)])
    velocity = np.cumsum(signs) * acceleration * TICK_S
    position = np.concatenate([[0.0], np.cumsum(velocity) * TICK_S])
    return np.repeat(position[:, None], 7, axis=1)


@given(st.integers(2, 200), st.integers(1, 100), st.floats(0.1, 10.0))
def test_filtering_keeps_both_ends_and_bounds_the_jerk(samples: int, window: int, acceleration: float) -> None:
    trajectory = Trajectory(raw_q_rad=_ramp(samples, acceleration), window=window)
    filtered = trajectory.filtered()
    assert len(filtered) == 2 * samples + window
    assert trajectory.duration_s == pytest.approx((len(filtered) - 1) * TICK_S)
    np.testing.assert_allclose(filtered[[0, -1]], trajectory.raw_q_rad[[0, -1]], atol=1e-12)
    rest = np.pad(filtered, ((3, 3), (0, 0)), mode="edge")
    jerk = np.diff(rest, n=3, axis=0) / TICK_S**3
    assert np.abs(jerk).max() <= 2.0 * acceleration / (window * TICK_S) * (1 + 1e-6) + 1e-3


def test_a_window_of_one_changes_nothing() -> None:
    samples = _ramp(5, 3.0)
    np.testing.assert_allclose(moving_average(samples, 1), samples, atol=1e-15)


@pytest.mark.parametrize("bad", [np.zeros((0, 7)), np.zeros((3, 5)), np.full((2, 7), np.nan)])
def test_a_trajectory_that_cannot_be_played_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(ValidationError):
        Trajectory(raw_q_rad=bad, window=4)


@pytest.mark.parametrize(("samples", "window"), [(2, 10**9), (2, 0), (300_001, 16)])
def test_what_would_fill_the_memory_is_no_trajectory(samples: int, window: int) -> None:
    with pytest.raises(ValueError, match=r"at most|at least"):
        Trajectory(raw_q_rad=np.zeros((samples, 7)), window=window)
