"""Several views of one scene: averaged clouds, the mounting corrected by their disagreement, table or mounting named.

The views are depth images of a table with a box and a cylinder, computed exactly, with noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import permutations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus.messages import CameraModel
from bus.transforms import angle_between_rad, from_rotation, from_translation, inverse
from config.load import load_station
from perception.fusion.mounting import PRIOR_M, PRIOR_RAD, MountCorrection, common_correction
from perception.fusion.table_or_mount import TableOrMount, table_or_mount
from perception.geometry.depth import moved, rays
from perception.geometry.voxels import averaged
from perception.scene.depth_view import DepthView
from perception.scene.normals import surface
from perception.scene.table import find_table

CAMERA = CameraModel(width=320, height=288, fx=252.3, fy=252.3, cx=160.1, cy=150.4)
COLOR_FROM_DEPTH = from_rotation(Rotation.from_euler("x", 6.0, degrees=True).as_matrix(), (-0.032, -0.002, 0.004))
STATION = load_station()
MIDDLE = np.array([0.46, 0.0, 0.0])
BOX_LOW, BOX_HIGH = np.array([0.40, -0.08, 0.0]), np.array([0.48, -0.02, 0.05])
AXIS_XY, RADIUS_M, HEIGHT_M = np.array([0.50, 0.06]), 0.04, 0.12
NOISE_M = 0.001
ABOVE, LEFT, RIGHT = (0.0, 180.0), (45.0, 120.0), (45.0, 240.0)
"""Tilt and azimuth [deg] of the direction to the camera."""


def looking_from(tilt_deg: float, azimuth_deg: float) -> np.ndarray:
    """The colour camera's pose 0.6 m from the middle."""
    tilt, azimuth = np.deg2rad([tilt_deg, azimuth_deg])
    away = np.array([np.cos(azimuth), np.sin(azimuth)])
    z = np.array([*-np.sin(tilt) * away, -np.cos(tilt)])
    x = np.array([-away[1], away[0], 0.0])
    return from_rotation(np.column_stack([x, np.cross(z, x), z]), MIDDLE - 0.6 * z)


def exact_depth_m(base_from_color: np.ndarray) -> np.ndarray:
    """The nearest of table, box and cylinder along each ray; z of the rays is 1, so the distance is the depth."""
    base_from_depth = base_from_color @ COLOR_FROM_DEPTH
    start, along = base_from_depth[:3, 3], rays(CAMERA) @ base_from_depth[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        table = -start[2] / along[..., 2]
        walls = np.sort([(BOX_LOW - start) / along, (BOX_HIGH - start) / along], axis=0)
        enter, leave = walls[0].max(axis=-1), walls[1].min(axis=-1)
        box = np.where(enter < leave, enter, np.inf)
        nearest = np.fmin(np.fmin(table, box), np.fmin(_tube(start, along), _lid(start, along)))
    return np.asarray(nearest, dtype=np.float32)


def _tube(start: np.ndarray, along: np.ndarray) -> np.ndarray:
    off, a = start[:2] - AXIS_XY, (along[..., :2] ** 2).sum(-1)
    b = (along[..., :2] * off).sum(-1)
    distance = (-b - np.sqrt(b**2 - a * (off @ off - RADIUS_M**2))) / a
    z = start[2] + distance * along[..., 2]
    return np.where((z > 0) & (z < HEIGHT_M), distance, np.nan)


def _lid(start: np.ndarray, along: np.ndarray) -> np.ndarray:
    distance = (HEIGHT_M - start[2]) / along[..., 2]
    at = start[:2] + distance[..., None] * along[..., :2]
    return np.where(np.hypot(*np.moveaxis(at - AXIS_XY, -1, 0)) < RADIUS_M, distance, np.nan)


def view_of(depth_m: np.ndarray, base_from_color: np.ndarray) -> DepthView:
    base_from_depth = base_from_color @ COLOR_FROM_DEPTH
    points = moved((rays(CAMERA) * depth_m[..., None]).astype(np.float32), base_from_depth)
    return DepthView(depth_m, CAMERA, base_from_depth, points)


@cache
def measured_m(tilt_deg: float, azimuth_deg: float, noise_m: float = NOISE_M) -> np.ndarray:
    exact_m = exact_depth_m(looking_from(tilt_deg, azimuth_deg))
    rng = np.random.default_rng([int(tilt_deg), int(azimuth_deg)])
    return exact_m + rng.normal(0.0, noise_m, exact_m.shape).astype(np.float32)


def mount_error(mm: float, deg: float, seed: int) -> np.ndarray:
    shift, axis = np.random.default_rng(seed).normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(deg) * axis / np.linalg.norm(axis))
    return from_rotation(turn.as_matrix(), mm / 1e3 * shift / np.linalg.norm(shift))


def seen_from(
    directions: Sequence[tuple[float, float]], error: np.ndarray, base_from_base: np.ndarray | None = None
) -> tuple[list[DepthView], list[np.ndarray]]:
    """Views and poses as they are believed where the camera is mounted wrongly, and everything seen is moved."""
    motion = np.eye(4) if base_from_base is None else base_from_base
    believed = [motion @ looking_from(*direction) @ inverse(error) for direction in directions]
    views = [view_of(measured_m(*direction), pose) for direction, pose in zip(directions, believed, strict=True)]
    return views, believed


def corrected(views: list[DepthView], believed: list[np.ndarray]) -> MountCorrection:
    return common_correction(views, [surface(view) for view in views], believed)


def distances_m(points: np.ndarray) -> np.ndarray:
    """Distances of points (n, 3) from the nearest of table, box and cylinder."""
    outside = np.maximum(BOX_LOW - points, points - BOX_HIGH)
    box = np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0)
    beside = np.hypot(*(points[:, :2] - AXIS_XY).T) - RADIUS_M
    above = points[:, 2] - HEIGHT_M
    tube = np.hypot(np.maximum(beside, 0), np.maximum(above, 0)) + np.minimum(np.maximum(beside, above), 0)
    return np.asarray(np.abs(np.stack([points[:, 2], box, tube])).min(axis=0))


def fused_error_m(views: Sequence[DepthView]) -> float:
    """Mean distance of the averaged points above the table from the true shapes."""
    near = [np.abs(view.points_base - MIDDLE.astype(np.float32)).max(axis=-1) < 0.15 for view in views]
    points = np.concatenate([view.points_base[mask] for view, mask in zip(views, near, strict=True)])
    means, _, _ = averaged(points, points, 0.003)
    return float(distances_m(means[means[:, 2] > 0.008]).mean())


# --- normals ----------------------------------------------------------------------------------------------------------


def test_normals_of_table_and_lid_point_up_and_those_of_walls_sideways() -> None:
    pose = looking_from(*LEFT)
    view = view_of(measured_m(*LEFT), pose)
    seen = surface(view)
    z, normals = view.points_base[..., 2], seen.normals_base
    known = np.isfinite(normals[..., 0])
    flat = known & ((np.abs(z) < 0.003) | (np.abs(z - HEIGHT_M) < 0.003))
    wall = known & (z > 0.02) & (z < HEIGHT_M - 0.02) & (np.abs(z - BOX_HIGH[2]) > 0.01)
    assert known.mean() > 0.8 and flat.sum() > 5000 and wall.sum() > 200
    assert np.degrees(np.arccos(np.median(normals[flat][:, 2]))) < 8, "one view's noise over 10 mm"
    assert np.abs(np.median(normals[wall][:, 2])) < 0.1
    towards = np.einsum("nk,nk->n", pose[:3, 3] - view.points_base[known], normals[known])
    assert (towards > 0).mean() > 0.999


def test_there_is_no_normal_beside_a_step_or_a_hole_and_no_point_in_it() -> None:
    depth_m = np.full((CAMERA.height, CAMERA.width), 0.6, np.float32)
    depth_m[:, 160:] = 0.55
    depth_m[100, 50] = np.nan
    seen = surface(view_of(depth_m, looking_from(*ABOVE)))
    assert np.isnan(seen.normals_base[150, 157:163]).all() and np.isnan(seen.normals_base[97:104, 50]).all()
    assert np.isfinite(seen.normals_base[150, 20:150]).all()
    assert np.isnan(seen.points_base[98:103, 48:53]).all(), "a smoothed point needs its whole window"
    assert np.isfinite(seen.points_base[150, 20:150]).all()


# --- the cloud --------------------------------------------------------------------------------------------------------


def _points(seed: int, count: int) -> npt.NDArray[np.float32]:
    return np.random.default_rng(seed).uniform(-0.03, 0.03, (count, 3)).astype(np.float32)


def test_a_cube_holds_the_mean_of_its_points_and_colours_and_counts_them() -> None:
    points = np.array([[0.001, 0.001, 0.001], [0.011, 0.0, 0.0], [0.002] * 3, [0.002] * 3], np.float32)
    lab = np.array([[1.0], [1.0], [5.0], [5.0]], np.float32) * np.ones(3, np.float32)
    means, colors, count = averaged(points, lab, 0.005)
    np.testing.assert_allclose(means, [[0.005 / 3] * 3, [0.011, 0, 0]], atol=1e-8)
    np.testing.assert_allclose(colors[:, 2], [11 / 3, 1], atol=1e-6)
    assert count.tolist() == [3, 1]


@settings(deadline=None, max_examples=30)
@given(counts=st.lists(st.integers(0, 300), min_size=1, max_size=4), seed=st.integers(0, 1000))
def test_the_order_of_the_views_does_not_change_the_cloud(counts: list[int], seed: int) -> None:
    parts = [_points(seed + index, count) for index, count in enumerate(counts)]
    first, _, counted = averaged(np.concatenate(parts), np.concatenate(parts), 0.01)
    for order in permutations(parts):
        points, _, count = averaged(np.concatenate(order), np.concatenate(order), 0.01)
        np.testing.assert_allclose(points, first, atol=1e-6)
        np.testing.assert_array_equal(count, counted)
    again, _, _ = averaged(np.concatenate(parts), np.concatenate(parts), 0.01)
    assert again.tobytes() == first.tobytes()


@given(count=st.integers(1, 500), seed=st.integers(0, 1000), voxel_m=st.sampled_from([0.002, 0.005, 0.02]))
def test_each_point_lies_in_its_own_cube_and_no_cube_is_twice(count: int, seed: int, voxel_m: float) -> None:
    points, _, counted = averaged(_points(seed, count), _points(seed, count), voxel_m)
    cells = np.floor(points.astype(float) / voxel_m + 1e-4 * np.sign(points))
    assert counted.sum() == count
    assert len(np.unique(cells, axis=0)) > 0.98 * len(cells), "but for points on a cube's face"


def test_points_that_are_no_numbers_or_too_far_apart_are_refused() -> None:
    bad = np.full((1, 3), np.nan, np.float32)
    with pytest.raises(ValueError, match="not finite"):
        averaged(bad, bad, 0.003)
    far = np.array([[0, 0, 0], [1e4, 1e4, 1e4]], np.float32)
    with pytest.raises(ValueError, match="too many"):
        averaged(far, far, 1e-3)


# --- the mounting -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mm", "deg"), [(1.0, 0.3), (3.0, 0.5)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_wrong_mounting_is_found_and_the_fused_cloud_mended(mm: float, deg: float, seed: int) -> None:
    error = mount_error(mm, deg, seed)
    views, believed = seen_from([ABOVE, LEFT, RIGHT], error)
    found = corrected(views, believed)
    mended = [found.view(view, pose) for view, pose in zip(views, believed, strict=True)]
    assert found.pairs == 6 and not found.is_cut
    assert np.degrees(angle_between_rad(error, found.color_from_corrected)) < 0.12
    assert found.residual_after_m < 0.9 * found.residual_before_m
    assert fused_error_m(mended) < min(0.0015, 0.8 * fused_error_m(views))


def test_a_right_mounting_stays_as_it_is() -> None:
    views, believed = seen_from([ABOVE, LEFT, RIGHT], np.eye(4))
    found = corrected(views, believed)
    assert np.degrees(angle_between_rad(np.eye(4), found.color_from_corrected)) < 0.05
    assert np.linalg.norm(found.color_from_corrected[:3, 3]) < 0.001
    mended = [found.view(view, pose) for view, pose in zip(views, believed, strict=True)]
    assert fused_error_m(mended) < fused_error_m(views) + 5e-5


def test_the_correction_moves_poses_points_and_normals_alike() -> None:
    views, believed = seen_from([ABOVE, LEFT], mount_error(3.0, 0.5, 4))
    found = corrected(views, believed)
    moved_view = found.view(views[1], believed[1])
    better = believed[1] @ found.color_from_corrected
    again = view_of(measured_m(*LEFT), better)
    np.testing.assert_allclose(moved_view.base_from_depth, again.base_from_depth, atol=1e-12)
    np.testing.assert_allclose(moved_view.points_base, again.points_base, atol=1e-6)
    turned = found.surface(surface(views[1]), believed[1])
    np.testing.assert_allclose(turned.points_base, surface(again).points_base, atol=1e-6)
    np.testing.assert_allclose(turned.normals_base, surface(again).normals_base, atol=1e-2)


def test_views_without_a_common_surface_say_nothing() -> None:
    views, believed = seen_from([ABOVE, LEFT], mount_error(3.0, 0.5, 1))
    empty = [np.zeros(view.depth_m.shape, bool) for view in views]
    for found in (
        common_correction(views, [surface(view) for view in views], believed, empty),
        corrected(views[:1], believed[:1]),
    ):
        np.testing.assert_array_equal(found.color_from_corrected, np.eye(4))
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), [*[PRIOR_RAD] * 3, *[PRIOR_M] * 3])
        assert found.pairs == 0 and np.isnan(found.residual_before_m) and not found.is_cut


def test_what_views_determine_is_more_certain_than_before() -> None:
    found = corrected(*seen_from([ABOVE, LEFT, RIGHT], np.eye(4)))
    deviations = np.sqrt(np.diag(found.covariance))
    assert (deviations[:3] < 0.4 * PRIOR_RAD).all() and (deviations[3:] <= PRIOR_M).all()


def test_a_correction_beyond_belief_is_cut_and_says_so() -> None:
    error = from_rotation(Rotation.from_rotvec([np.deg2rad(2.5), 0.0, 0.0]).as_matrix())
    views, believed = seen_from([ABOVE, LEFT, RIGHT], error)
    found = corrected(views, believed)
    turn_rad = angle_between_rad(np.eye(4), found.color_from_corrected)
    assert turn_rad <= 3 * PRIOR_RAD + 1e-9
    assert found.is_cut and turn_rad == pytest.approx(3 * PRIOR_RAD)


def test_the_same_views_give_the_same_bits() -> None:
    views, believed = seen_from([ABOVE, LEFT, RIGHT], mount_error(1.0, 0.3, 5))
    one, other = corrected(views, believed), corrected(views, believed)
    assert one.color_from_corrected.tobytes() == other.color_from_corrected.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()


# --- table or mounting ------------------------------------------------------------------------------------------------


def _told(error: np.ndarray, tilt_deg: float, height_m: float = 0.0) -> TableOrMount:
    turn = from_rotation(Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix(), MIDDLE)
    motion = from_translation((0.0, 0.0, height_m)) @ turn @ from_translation(-MIDDLE)
    views, believed = seen_from([ABOVE, LEFT, RIGHT], error, motion)
    return table_or_mount([find_table(view.points_base, STATION) for view in views], believed, MIDDLE)


def test_neither_is_named_when_both_are_right() -> None:
    told = _told(np.eye(4), 0.0)
    assert told.named == "" and np.degrees(told.tilt_rad) < 0.1 and told.off_mounting < 0.3


@pytest.mark.parametrize("tilt_deg", [2.0, -4.0])
def test_a_table_that_leans_is_named(tilt_deg: float) -> None:
    told = _told(np.eye(4), tilt_deg, 0.004)
    assert told.named == "table"
    assert np.degrees(told.tilt_rad) == pytest.approx(abs(tilt_deg), abs=0.2)
    assert told.height_m == pytest.approx(0.004, abs=0.002), "less what is blamed on the mounting"
    assert told.off_mounting < 0.3


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_wrong_mounting_is_named(seed: int) -> None:
    error = mount_error(3.0, 0.6, seed)
    told = _told(error, 0.0)
    assert told.named == "mount" and np.degrees(told.tilt_rad) < 0.2
    assert np.degrees(angle_between_rad(error, told.color_from_corrected)) < 0.25


def test_what_cannot_be_told_stays_uncertain() -> None:
    """The height of the table and a shift along the view from above look alike."""
    told = _told(np.eye(4), 0.0)
    assert told.deviations[2] > 0.001 and told.deviations[6:].max() > 0.0015
    assert np.degrees(told.deviations[:2]).max() < 0.2
