"""The height field: what is seen is solid, what is hidden is solid, what is known or meant is left out."""

from __future__ import annotations

import coal
import numpy as np
import pytest

from config.scene import Box
from planning.height_field import CELL_M, ObservedHeightField, Sight, observed_field, solid
from planning.world import Thing
from tests.planning.conftest import STATION, box
from tests.planning.views import seen_from_above

TABLE = STATION.scene.table
EYE_M = (0.45, 0.0, 1.2)
TOWER = box("tower", (0.55, 0.20, 0.15), (0.10, 0.06, 0.30))
BRICK = box("brick", (0.30, -0.25, 0.04), (0.06, 0.12, 0.08))


def field_of(
    *boxes: Box,
    known: tuple[Box, ...] = (TABLE,),
    target: Box | None = None,
    noise_m: float = 0.0,
    holes_px: int = 0,
) -> ObservedHeightField | None:
    view = seen_from_above((TABLE, *boxes), eye_m=EYE_M, target=target, noise_m=noise_m, holes_px=holes_px)
    return observed_field([Sight(*view)], known)


def height_at(field: ObservedHeightField, x: float, y: float) -> float:
    column, row = np.rint((np.array([x, y]) - field.origin_m) / CELL_M).astype(int)
    inside = 0 <= row < field.height_m.shape[0] and 0 <= column < field.height_m.shape[1]
    return float(field.height_m[row, column]) if inside else -1.0


def is_solid(thing: Thing, point_m: np.ndarray) -> bool:
    result, ball = coal.CollisionResult(), coal.Sphere(0.001)
    pose = coal.Transform3s(np.eye(3), np.ascontiguousarray(thing.pose[:3, 3]))
    coal.collide(thing.shape, pose, ball, coal.Transform3s(np.eye(3), point_m), coal.CollisionRequest(), result)
    return bool(result.isCollision())


def test_an_empty_table_has_no_obstacle_whatever_the_noise() -> None:
    assert field_of(noise_m=0.0015) is None


def test_tops_are_where_they_are() -> None:
    field = field_of(TOWER, BRICK)
    assert field is not None
    assert height_at(field, 0.55, 0.20) == pytest.approx(0.30, abs=1e-3)
    assert height_at(field, 0.30, -0.25) == pytest.approx(0.08, abs=1e-3)
    assert height_at(field, 0.45, -0.05) < 0


def test_it_is_solid_wherever_a_box_is_and_free_far_from_boxes() -> None:
    field = field_of(TOWER, BRICK)
    assert field is not None
    for one in (TOWER, BRICK):
        low, size = np.array(one.center_m) - np.array(one.size_m) / 2, np.array(one.size_m)
        for share in np.random.default_rng(0).uniform(0.02, 0.98, (60, 3)):
            assert is_solid(field.thing, low + share * size)
    for point in ([0.55, -0.20, 0.05], [0.30, 0.25, 0.05], [0.45, 0.0, 0.02], [0.55, 0.20, 0.32], [0.30, -0.25, 0.1]):
        assert not is_solid(field.thing, np.array(point))


def test_what_the_tower_hides_is_solid() -> None:
    field = field_of(TOWER)
    assert field is not None
    edge = np.array([0.60, 0.23, 0.30])  # the top corner away from the camera
    behind = edge + 0.1 * (edge - EYE_M)
    assert is_solid(field.thing, behind - [0, 0, 0.02])
    assert not is_solid(field.thing, behind - [0, 0, -0.03])


def test_holes_at_edges_are_bridged() -> None:
    holed = field_of(TOWER, holes_px=3)
    assert holed is not None
    hidden = np.array([0.62, 0.20, 0.05])
    assert not any(np.hypot(*(point[:2] - hidden[:2])) < 0.01 for point in seen_from_above(
        (TABLE, TOWER), eye_m=EYE_M, holes_px=3)[0].reshape(-1, 3))  # fmt: skip
    assert is_solid(holed.thing, hidden)


def test_known_boxes_are_left_out() -> None:
    field = field_of(TOWER, BRICK, known=(TABLE, TOWER))
    assert field is not None
    assert height_at(field, 0.55, 0.20) < 0.013
    assert height_at(field, 0.30, -0.25) == pytest.approx(0.08, abs=1e-3)


def test_the_target_is_left_out_and_hides_nothing() -> None:
    target = box("target", (0.45, 0.0, 0.03), (0.05, 0.05, 0.06))
    assert field_of(target=target) is None
    beside = field_of(BRICK, target=target)
    assert beside is not None
    assert height_at(beside, 0.45, 0.0) < 0


def test_every_seen_point_lies_in_the_field() -> None:
    field = field_of(TOWER, BRICK, noise_m=0.001)
    assert field is not None
    assert all(is_solid(field.thing, point - [0, 0, 0.002]) for point in field.points[::97])


# --- several looks ----------------------------------------------------------------------------------------------------

FROM_LEFT_M, FROM_RIGHT_M = (0.45, 0.55, 0.8), (0.45, -0.55, 0.8)
POST = box("post", (0.45, 0.0, 0.10), (0.06, 0.06, 0.20))
WELL = tuple(
    box("wall", center_m, size_m)
    for center_m, size_m in (
        ((0.45, 0.06, 0.15), (0.14, 0.02, 0.30)),
        ((0.45, -0.06, 0.15), (0.14, 0.02, 0.30)),
        ((0.39, 0.0, 0.15), (0.02, 0.14, 0.30)),
        ((0.51, 0.0, 0.15), (0.02, 0.14, 0.30)),
    )
)
"""Four walls around a place that no camera sees from aside."""
LEFT_OF_IT, RIGHT_OF_IT = np.array([0.45, 0.08, 0.05]), np.array([0.45, -0.08, 0.05])


def seen_from(*eyes_m: tuple[float, float, float], boxes: tuple[Box, ...] = (POST,)) -> ObservedHeightField:
    sights = [Sight(*seen_from_above((TABLE, *boxes), eye_m=eye_m)) for eye_m in eyes_m]
    field = observed_field(sights, (TABLE,))
    assert field is not None
    return field


def test_what_only_one_of_two_looks_hides_is_free() -> None:
    left, right = seen_from(FROM_LEFT_M), seen_from(FROM_RIGHT_M)
    assert is_solid(left.thing, RIGHT_OF_IT) and not is_solid(left.thing, LEFT_OF_IT)
    assert is_solid(right.thing, LEFT_OF_IT) and not is_solid(right.thing, RIGHT_OF_IT)
    both = seen_from(FROM_LEFT_M, FROM_RIGHT_M)
    assert not is_solid(both.thing, LEFT_OF_IT) and not is_solid(both.thing, RIGHT_OF_IT)
    assert is_solid(both.thing, np.array(POST.center_m)), "the thing itself"


def test_what_both_looks_hide_is_solid() -> None:
    both = seen_from(FROM_LEFT_M, FROM_RIGHT_M, boxes=WELL)
    assert is_solid(both.thing, np.array([0.45, 0.0, 0.05]))
    assert not is_solid(both.thing, np.array([0.45, 0.0, 0.32]))


def test_what_only_one_of_two_looks_shows_is_an_obstacle() -> None:
    """A low brick, to the right of the post and wholly in its shadow, seen from the left."""
    brick = box("brick", (0.45, -0.06, 0.015), (0.03, 0.03, 0.03))
    hidden, shown = seen_from(FROM_LEFT_M, boxes=(POST, brick)), seen_from(FROM_RIGHT_M, boxes=(POST, brick))
    both = seen_from(FROM_LEFT_M, FROM_RIGHT_M, boxes=(POST, brick))
    assert height_at(hidden, 0.45, -0.06) > 0.05, "the shadow"
    assert height_at(shown, 0.45, -0.06) == pytest.approx(0.03, abs=2e-3)
    assert height_at(both, 0.45, -0.06) == pytest.approx(0.03, abs=2e-3)


def test_the_order_of_the_looks_changes_nothing_and_the_same_look_twice_is_one() -> None:
    both, turned = seen_from(FROM_LEFT_M, FROM_RIGHT_M), seen_from(FROM_RIGHT_M, FROM_LEFT_M)
    np.testing.assert_array_equal(both.height_m, turned.height_m)
    once, twice = seen_from(FROM_LEFT_M), seen_from(FROM_LEFT_M, FROM_LEFT_M)
    np.testing.assert_allclose(twice.origin_m, once.origin_m)
    np.testing.assert_array_equal(twice.height_m, once.height_m)


def test_the_points_that_the_gate_checks_hold_no_shadow_that_another_look_lifts() -> None:
    both = seen_from(FROM_LEFT_M, FROM_RIGHT_M)
    beside = np.abs(both.points[:, 1]) > 0.045
    assert not beside.any(), both.points[beside]


def test_a_single_row_of_points_is_a_solid_too() -> None:
    row = np.stack([np.linspace(0.0, 0.1, 50), np.zeros(50), np.full(50, 0.03)], axis=1)
    assert is_solid(Thing("rod", solid(row, 0.0)), np.array([0.05, 0.0, 0.01]))
    assert not is_solid(Thing("rod", solid(row, 0.0)), np.array([0.05, 0.01, 0.01]))
