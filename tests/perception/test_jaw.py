"""Two patches of colour side by side between the fingers are a seam; stripes, rims and shades are none."""

from __future__ import annotations

import numpy as np
import pytest

from perception.scene.jaw import _beside, _has_seam

RED, BLUE, DARK_RED = (30.0, 60.0, 40.0), (15.0, 20.0, -60.0), (24.0, 58.0, 38.0)
"""CIELAB, its lightness as the rule takes it."""


def _across(*patches: tuple[float, tuple[float, float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Bins of 2 mm and colours of patches (width [mm], colour) along the closing axis, with the camera's noise."""
    colors = np.concatenate([np.tile(color, (round(width_mm / 2) * 8, 1)) for width_mm, color in patches])
    cell = np.repeat(np.arange(len(colors) // 8), 8)
    return cell, colors + np.random.default_rng(0).normal(0, 1.5, colors.shape)


@pytest.mark.parametrize(
    ("patches", "is_seam"),
    [
        (((24, RED), (24, BLUE)), True),
        (((36, RED), (12, BLUE)), True),
        (((48, RED),), False),
        (((44, RED), (4, BLUE)), False),
        (((20, RED), (8, BLUE), (20, RED)), False),
        (((24, RED), (24, DARK_RED)), False),
        ((), False),
    ],
    ids=["two", "two, one narrow", "one", "a rim", "a stripe in the middle", "two faces of one colour", "nothing"],
)
def test_a_seam_is_where_two_even_patches_meet(
    patches: tuple[tuple[float, tuple[float, float, float]], ...], is_seam: bool
) -> None:
    across = _across(*patches) if patches else (np.zeros(0, dtype=int), np.zeros((0, 3)))
    assert _has_seam(*across) is is_seam


def test_what_lies_beside_the_thing_is_between_the_fingers_and_what_lies_below_is_not() -> None:
    cell = np.repeat(np.arange(20), 4)
    beside = np.where(cell < 12, 1, 2)
    assert _beside(cell, beside, 1) == (2,)
    below = np.where(np.arange(80) % 4 == 0, 2, 1)
    assert _beside(cell, below, 1) == ()
