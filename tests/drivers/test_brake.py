"""Coming to rest without a path to stay on."""

from __future__ import annotations

import numpy as np
import pytest

from bus.errors import DriverError
from bus.trajectory import moving_average
from config.limits import ACCELERATION_RAD_S2, FR3, JERK_RAD_S3
from drivers.motion.brake import brake_without_path

START = np.array([0.0, -0.55, 0.0, -2.1, 0.0, 1.55, 0.785])


def swing(window: int = 64) -> np.ndarray:
    """1 kHz commands at full acceleration, cruise and full braking, each joint by another distance."""
    t = np.arange(0.0, 0.8, 1e-3)
    s = np.where(t < 0.2, 4.9 * t**2, np.where(t < 0.6, 0.196 + 1.96 * (t - 0.2), 1.176 - 4.9 * (0.8 - t) ** 2))
    return moving_average(START + s[:, None] * np.array([1.0, 0.5, -0.7, 0.3, -0.2, 0.8, -1.0]), window)


@pytest.mark.parametrize("at", range(5, 850, 65))
def test_from_anywhere_in_a_motion_it_comes_to_rest_within_acceleration_and_jerk(at: int) -> None:
    before = swing()[: at + 1]
    after = brake_without_path(FR3, before[-3:])
    commands = np.concatenate([before[-5:], after, np.repeat(after[-1:], 4, axis=0)])
    assert (np.abs(np.diff(commands, n=2, axis=0)).max(axis=0) * 1e6 <= ACCELERATION_RAD_S2).all()
    assert (np.abs(np.diff(commands, n=3, axis=0)).max(axis=0) * 1e9 <= JERK_RAD_S3).all()
    assert len(after) < 400


def test_at_rest_it_stays() -> None:
    assert np.array_equal(brake_without_path(FR3, np.tile(START, (3, 1))), START[None])


def test_what_is_no_state_is_refused() -> None:
    with pytest.raises(DriverError, match="not finite"):
        brake_without_path(FR3, np.full((3, 7), np.nan))
