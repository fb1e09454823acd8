"""The picture of a scene: every thing in its own colour, what was not seen hatched, all in the undistorted image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from bus.messages import Frame
from bus.transforms import from_rotation
from config.load import load_station
from logs.mcap.reader import read_cycle
from logs.report.images import undistorted
from logs.report.scene import region_px
from logs.scene_picture import color_of, draw_scene, outlines_px, places_px, unseen_px
from perception.geometry.depth import register
from tests.logs.conftest import scene_of


def _mask() -> np.ndarray:
    mask = np.zeros((90, 160), dtype=bool)
    mask[30:50, 60:90] = True
    return mask


def test_the_things_of_a_full_bin_have_colours_that_can_be_told_apart() -> None:
    colors = [np.array(color_of(number), dtype=float) for number in range(1, 13)]
    assert min(np.linalg.norm(one - other) for one, other in combinations(colors, 2)) > 25


def test_only_things_and_what_was_not_seen_are_painted_over() -> None:
    scene, plain = scene_of(_mask()), np.full((90, 160, 3), 128, np.uint8)
    drawn = draw_scene(plain, scene)
    changed = (drawn != plain).any(axis=2)
    near = np.zeros_like(changed)
    near[28:52, 58:92] = True
    assert (changed & ~near & ~scene.unseen).sum() == 0
    assert changed[_mask()].all() and plain.min() == 128
    assert {tuple(pixel) for pixel in drawn[:8, :8].reshape(-1, 3)} > {(128, 128, 128)}  # striped, not covered


def test_a_number_stands_deepest_inside_and_a_thing_without_a_pixel_has_none() -> None:
    labels = _mask().astype(np.uint8)
    labels[5, 5] = 2
    ((u, v),) = (places_px(labels, [1, 3])[1],)
    assert set(places_px(labels, [1, 3])) == {1} and 69 <= u <= 80 and 38 <= v <= 41


def test_a_speck_has_no_outline() -> None:
    mask = _mask()
    mask[5, 5] = True
    assert [outline.min(axis=0).tolist() for outline in outlines_px(mask)] == [[60, 30]]


def test_the_rims_of_what_was_not_seen_leave_out_things_specks_and_holes() -> None:
    scene = scene_of(_mask())
    unseen = np.zeros_like(scene.unseen)
    unseen[20:70, 20:120] = True
    unseen[55:65, 30:50] = False
    unseen[5, 5] = True
    rims = unseen_px(scene.model_copy(update={"unseen": unseen}))
    filled = np.zeros(unseen.shape, np.uint8)
    cv2.fillPoly(filled, rims, 1)  # even-odd, as a page fills them
    expected = unseen & (scene.labels == 0)
    expected[5, 5] = False
    assert len(rims) == 3 and (filled.astype(bool) != expected).mean() < 0.02


def test_the_image_is_undistorted_as_detect_does(frame: Frame) -> None:
    assert frame.color_camera.distortion
    flat = frame.model_copy(update={"depth_m": np.ones_like(frame.depth_m)})
    assert np.array_equal(undistorted(frame), register(flat).color)
    straight = frame.model_copy(update={"color_camera": frame.color_camera.model_copy(update={"distortion": ()})})
    assert undistorted(straight) is straight.color


def test_the_pick_region_is_drawn_on_the_seen_table(record: Callable[..., Path]) -> None:
    """The camera is at the origin of ``base`` and looks down; the table is 0.5 m below it, and tilted about y."""
    told = read_cycle(record())
    assert told.scene is not None and told.observation is not None
    camera = told.observation.frame.color_camera
    x_min, x_max, y_min, y_max = load_station().scene.pick_region_m
    for tilt_rad in (0.0, 0.1):
        rotation = Rotation.from_euler("y", tilt_rad).as_matrix()
        pose = from_rotation(rotation, (0.0, 0.0, -0.5))
        corners = region_px(told, told.scene.table.model_copy(update={"base_from_table": pose}), told.observation)
        assert corners is not None
        depth_m = 0.5 + np.tan(tilt_rad) * np.array([x_min, x_max, x_max, x_min])
        u = camera.cx + camera.fx * np.array([x_min, x_max, x_max, x_min]) / depth_m
        v = camera.cy - camera.fy * np.array([y_min, y_min, y_max, y_max]) / depth_m
        assert np.allclose(corners, np.stack([u, v], axis=1))


def test_a_region_behind_the_camera_or_of_no_known_place_is_not_drawn(record: Callable[..., Path]) -> None:
    told = read_cycle(record())
    assert told.scene is not None
    above = told.scene.table.model_copy(update={"base_from_table": from_rotation(np.eye(3), (0.0, 0.0, 0.5))})
    assert region_px(told, above, told.observation) is None
    assert region_px(replace(told, station={}), told.scene.table, told.observation) is None
