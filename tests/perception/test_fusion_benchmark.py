"""The yardstick of fused views: distances from the true shapes, scenes from three sides, and what is printed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks import fusion
from benchmarks.fused.scenes import KINDS, see
from benchmarks.fused.truth import distances_m
from benchmarks.heaps.shapes import box_corners
from bus.transforms import angle_between_rad
from drivers.sim.optics import DEPTH

NOWHERE = Path("no folder is read but for heaps")
CYLINDER = KINDS.index("cylinder")
BLOCK = box_corners(np.array([0.1, 0.1, 0.05]), np.array([0.4, 0.0, 0.025]))


def _points(*points: tuple[float, float, float]) -> np.ndarray:
    return np.array(points, np.float32)


def test_a_point_is_as_far_off_as_it_lies_before_or_behind_the_surface() -> None:
    on_top, above, inside, beside = (0.4, 0, 0.05), (0.4, 0, 0.053), (0.4, 0, 0.048), (0.451, 0, 0.03)
    found = distances_m(_points(on_top, above, inside, beside), [BLOCK])
    np.testing.assert_allclose(found, [0, 0.003, 0.002, 0.001], atol=1e-6)


def test_two_parts_that_overlap_have_one_surface() -> None:
    other = BLOCK + np.array([0.04, 0.0, 0.02])
    np.testing.assert_allclose(distances_m(_points((0.44, 0, 0.071)), [BLOCK, other]), [0.001], atol=1e-6)
    assert len(distances_m(_points((0.40, 0, 0.051)), [BLOCK, other])) == 1


def test_points_of_the_table_are_left_out_and_points_in_the_air_count() -> None:
    assert len(distances_m(_points((0.4, 0.2, 0.002), (0.452, 0, 0.003)), [BLOCK])) == 0
    np.testing.assert_allclose(distances_m(_points((0.2, 0.2, 0.3)), [BLOCK]), [0.015])


def test_a_scene_is_seen_from_three_sides_and_each_time_alike() -> None:
    seen, again = see(CYLINDER, NOWHERE), see(CYLINDER, NOWHERE)
    assert seen.kind == "cylinder" and len(seen.depths_m) == 3
    for depth_m, other_m in zip(seen.depths_m, again.depths_m, strict=True):
        assert depth_m.shape == (DEPTH.height, DEPTH.width)
        np.testing.assert_array_equal(depth_m, other_m)
    first, second, third = seen.true_base_from_color
    assert np.degrees(np.arccos(-second[2, 2])) > 44 > 1 > np.degrees(np.arccos(-first[2, 2]))
    assert angle_between_rad(second, third) > 1


def test_the_figures_tell_what_the_correction_mends() -> None:
    shown = fusion.run([], [CYLINDER], NOWHERE, lambda line: None)
    right, _, wrong = shown["mountings"]
    assert shown["scenes"] == 1 and shown["development"] == {}
    assert wrong["error_mm_after"][0] < 0.6 * wrong["error_mm_before"][0]
    assert right["error_mm_after"][0] < right["error_mm_before"][0] + 0.2
    assert wrong["rotation_deg_after"] < wrong["rotation_deg_before"] == 0.5
    assert (right["named_mount"], wrong["named_mount"], shown["named_table_when_tilted"]) == (0.0, 1.0, 1.0)
