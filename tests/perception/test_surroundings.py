"""What planning is shown: the depth image as points in ``base``, the target marked, rims not lost."""

from __future__ import annotations

import numpy as np
import pytest

from bus.messages import CameraModel, Frame, Observation, View
from perception.scene.surroundings import surroundings

HEIGHT_M, BLOCK_M = 0.70, 0.10
CAMERA = CameraModel(width=160, height=120, fx=150.0, fy=150.0, cx=79.5, cy=59.5)
BLOCK = np.s_[40:80, 60:100]
BASE_FROM_COLOR = np.array([[0.0, -1, 0, 0.45], [-1, 0, 0, 0.0], [0, 0, -1, HEIGHT_M], [0, 0, 0, 1]])


def observation(*, rim_px: int = 0) -> tuple[Observation, np.ndarray]:
    """A camera that looks straight down on a block; around it ``rim_px`` pixels have no depth. And the block's mask."""
    depth_m = np.full((CAMERA.height, CAMERA.width), HEIGHT_M, dtype=np.float32)
    rows, columns = BLOCK
    if rim_px:
        depth_m[rows.start - rim_px : rows.stop + rim_px, columns.start - rim_px : columns.stop + rim_px] = np.nan
    depth_m[BLOCK] = HEIGHT_M - BLOCK_M
    mask = np.zeros(depth_m.shape, dtype=bool)
    mask[BLOCK] = True
    color = np.zeros((*depth_m.shape, 3), dtype=np.uint8)
    frame = Frame(stamp_ns=1, color=color, depth_m=depth_m, color_camera=CAMERA, depth_camera=CAMERA,
                  color_from_depth=np.eye(4))  # fmt: skip
    return Observation(view=View(stamp_ns=1, base_from_color=BASE_FROM_COLOR), frame=frame), mask


def test_every_point_is_at_its_place_in_base() -> None:
    seen, mask = observation()
    points, _ = surroundings(seen, mask)
    assert points[..., 2].min() == pytest.approx(0.0, abs=1e-5)
    top = points[points[..., 2] > 0.05]
    assert np.allclose(top[:, 2], BLOCK_M, atol=1e-5)
    size_px = np.ptp(top[:, :2], axis=0) / (HEIGHT_M - BLOCK_M) * CAMERA.fx
    assert np.allclose(size_px, 40, atol=3)
    forward = points[0, 40, 0] - points[-1, 40, 0]
    assert forward > 0, "up in the image is forward"


def test_the_targets_points_are_those_of_its_mask() -> None:
    seen, mask = observation()
    points, target = surroundings(seen, mask)
    assert np.array_equal(target, points[..., 2] > 0.05)


def test_a_lost_rim_is_taken_for_the_nearer_surface() -> None:
    seen, _ = observation(rim_px=4)
    points, _ = surroundings(seen, np.zeros((CAMERA.height, CAMERA.width), dtype=bool))
    assert np.isfinite(points).all()
    whole, _ = surroundings(observation()[0], np.zeros((CAMERA.height, CAMERA.width), dtype=bool))
    assert ((points[..., 2] > 0.05) >= (whole[..., 2] > 0.05)).all()
    assert (points[..., 2] > 0.05).sum() > (whole[..., 2] > 0.05).sum()


def test_the_targets_lost_rim_is_no_obstacle_beside_it() -> None:
    seen, mask = observation(rim_px=4)
    points, target = surroundings(seen, mask)
    raised = points[..., 2] > 0.05
    assert raised.any() and np.array_equal(raised, target)


def test_where_nothing_is_seen_there_is_no_point() -> None:
    seen, mask = observation()
    dark = np.array(seen.frame.depth_m)
    dark[:, :40] = np.nan
    blind = seen.model_copy(update={"frame": seen.frame.model_copy(update={"depth_m": dark})})
    points, target = surroundings(blind, mask)
    assert np.isnan(points[:, :15]).all()
    assert not target[:, :15].any()
