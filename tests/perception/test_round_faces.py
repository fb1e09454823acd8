"""Chords of round things: the jaw closes where the faces stand across it, and slips off where they lean too much."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from config.load import load_station
from perception.grasps.closing import close
from perception.scene.heightmap import CELL_M, HeightMap

STATION = load_station(None)
HEIGHT_M, CELLS, NOISE_M, PAD_M = 0.04, 161, 0.0007, 0.01
DISCS, CHORDS = 60, 60


def disc(radius_m: float, center_m: npt.NDArray[np.float64], rng: np.random.Generator) -> HeightMap:
    """An upright cylinder whose rim is seen with noise."""
    origin_m = np.full(2, -(CELLS - 1) / 2 * CELL_M)
    x, y = np.meshgrid(*(origin_m[:, None] + np.arange(CELLS) * CELL_M))
    from_middle_m = np.hypot(x - center_m[0], y - center_m[1])
    seen = from_middle_m + rng.normal(0, NOISE_M, x.shape) < radius_m
    heights = np.where(seen, HEIGHT_M, 0).astype(np.float32)
    labels = (from_middle_m < radius_m).astype(np.int16)
    return HeightMap(heights, heights, labels, labels, labels, origin_m)


@pytest.fixture(scope="module")
def closed() -> npt.NDArray[np.float64]:
    """Of many chords: the angle of the face where the pad touches it [deg], and whether the jaw may close there."""
    rng = np.random.default_rng(3)
    rows = []
    for _ in range(DISCS):
        radius_m, center_m = rng.uniform(0.030, 0.038), rng.uniform(-0.001, 0.001, 2)
        heading, off_m = rng.uniform(0, np.pi, CHORDS), rng.uniform(0, 0.035, CHORDS)
        centers_m = center_m + off_m[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)])
        closings = close(disc(radius_m, center_m, rng), centers_m, heading, np.full(CHORDS, HEIGHT_M / 2), STATION)
        leans_deg = np.degrees(np.arcsin(np.clip((off_m - PAD_M) / radius_m, 0, 1)))
        rows.append(np.column_stack([leans_deg, np.isfinite(closings.score)]))
    return np.concatenate(rows)


@pytest.mark.parametrize(("from_deg", "to_deg", "least", "most"), [(0, 5, 0.95, 1.0), (28, 40, 0.0, 0.02)])
def test_a_chord_is_held_by_how_its_faces_lean(
    closed: npt.NDArray[np.float64], from_deg: float, to_deg: float, least: float, most: float
) -> None:
    ours = closed[(closed[:, 0] >= from_deg) & (closed[:, 0] < to_deg)]
    assert len(ours) > 200
    assert least <= ours[:, 1].mean() <= most
