"""The steps of Algorithm 1 on clouds and masks whose truth is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import CameraModel, Frame
from bus.transforms import apply, inverse
from config.load import load_station
from perception.geometry.depth import register, without_flying_pixels
from perception.geometry.lift import lift, lift_pixels, project
from perception.geometry.rod import fit_line, rectangle, runs

CAMERA = CameraModel(width=320, height=240, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
STATION = load_station()


@given(st.lists(st.tuples(st.floats(0, 319), st.floats(0, 239), st.floats(0.3, 2.0)), min_size=1, max_size=20))
def test_lifting_undoes_projection(pixels: list[tuple[float, float, float]]) -> None:
    values = np.array(pixels)
    points = lift_pixels(values[:, :2], values[:, 2], CAMERA)
    np.testing.assert_allclose(project(points, CAMERA), values[:, :2], atol=1e-9)


@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_the_inverse_of_a_pose_undoes_it(numbers: list[float]) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(numbers[:3]).as_matrix()
    pose[:3, 3] = numbers[3:]
    np.testing.assert_allclose(inverse(pose) @ pose, np.eye(4), atol=1e-12)


def _rod(gaps: list[tuple[int, int]], angle_deg: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """Masks of a rod 200 px long and 9 px wide with pieces hidden by an object that covers exactly the gaps."""
    rod, hidden = (np.zeros((240, 320), np.uint8) for _ in range(2))
    cv2.rectangle(rod, (60, 116), (260, 124), 1, -1)
    for start, end in gaps:
        cv2.rectangle(hidden, (start, 90), (end, 150), 1, -1)
    rod[hidden > 0] = 0
    turn = cv2.getRotationMatrix2D((160, 120), -angle_deg, 1.0)
    rod, hidden = (cv2.warpAffine(mask, turn, (320, 240), flags=cv2.INTER_NEAREST) for mask in (rod, hidden))
    return rod > 0, hidden > 0


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 77.0, 120.0])
def test_one_gap_is_one_run_with_its_own_middle(angle_deg: float) -> None:
    rod, hidden = _rod([(120, 160)], angle_deg)
    line = fit_line(rod)
    (run,) = runs(line, rod, hidden)
    assert run[1] - run[0] == pytest.approx(41, abs=2)
    ends = lift_pixels(line.at(np.array(run)), np.full(2, 0.6), CAMERA)
    box = rectangle(ends, CAMERA, STATION)
    turn = np.deg2rad(angle_deg)
    middle = np.array([160, 120]) + (140 - 160) * np.array([np.cos(turn), np.sin(turn)])
    np.testing.assert_allclose(box.center_px, middle, atol=2.0)
    apart = abs(box.angle_rad - turn) % np.pi
    assert min(apart, np.pi - apart) < np.deg2rad(1.5)
    assert box.height_px == pytest.approx(0.020 * 300 / 0.6)


def test_two_gaps_are_two_runs_and_the_outer_pair() -> None:
    rod, hidden = _rod([(110, 125), (180, 200)], 0.0)
    line = fit_line(rod)
    widths = [run[1] - run[0] for run in runs(line, rod, hidden)]
    assert widths == pytest.approx([91, 21, 16], abs=2)


def test_a_gap_beside_the_object_does_not_count_and_no_gap_is_the_chord() -> None:
    rod, hidden = _rod([(120, 160)], 0.0)
    line = fit_line(rod)
    elsewhere = np.zeros_like(hidden)
    assert runs(line, rod, elsewhere) == []
    whole, _ = _rod([], 0.0)
    (chord,) = runs(fit_line(whole), whole, hidden & ~whole)
    assert chord[1] - chord[0] == pytest.approx(41, abs=2)


def test_two_crossing_rods_are_no_rod() -> None:
    one, other = _rod([], 0.0)[0], _rod([], 70.0)[0]
    with pytest.raises(CycleFailure) as failure:
        fit_line(one | other)
    assert failure.value.failure is Code.MODEL_NO_ROD


def test_flying_pixels_are_dropped_and_surfaces_kept() -> None:
    depth_m = np.full((40, 40), 0.8, np.float32)
    depth_m[:, 20:] = 0.6
    depth_m[10, 20] = 0.7
    clean = without_flying_pixels(depth_m)
    assert np.isnan(clean[10, 20]) and np.isfinite(clean).sum() >= 40 * 40 - 10


def test_registration_brings_depth_to_the_right_colour_pixel(frame: Frame) -> None:
    """A tilted plane seen by the depth camera lies on the same plane in the colour camera."""
    camera = frame.depth_camera.model_copy(update={"distortion": ()})
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    normal, distance = np.array([0.1, -0.2, 1.0]), 0.7
    depth_m = distance / (rays @ normal)
    seen = frame.model_copy(update={"depth_camera": camera, "depth_m": depth_m.astype(np.float32)})
    rgbd = register(seen)
    points = lift(np.isfinite(rgbd.depth_m), rgbd.depth_m, rgbd.camera)
    depth_from_color = inverse(frame.color_from_depth)
    residual = apply(depth_from_color, points) @ normal - distance
    assert len(points) > 2000 and np.percentile(np.abs(residual), 95) < 0.004
