"""Of a thing that may be several, only what is connected to what the pads hold goes where the hand goes."""

from __future__ import annotations

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from planning.height_field import Sight
from planning.held_part import held_parts
from planning.pick import plan_pick
from planning.robot import Robot
from planning.scene import Scene
from tests.planning.conftest import CAPTURE, STATION, box
from tests.planning.test_pick import grasp
from tests.planning.views import seen_from_above

TABLE = STATION.scene.table
EYE_M = (0.45, 0.0, 1.2)
BRICK = box("brick", (0.45, 0.05, 0.03), (0.04, 0.10, 0.06))
PILLAR = box("pillar", (0.45, -0.10, 0.13), (0.06, 0.06, 0.26))
ON_THE_BRICK = grasp(0.45, 0.05, 0.05, yaw=np.pi / 2)


def _merged() -> Sight:
    """Brick and pillar, which perception took for one thing."""
    points, is_pillar = seen_from_above((TABLE, BRICK), eye_m=EYE_M, target=PILLAR)
    return Sight(points, is_pillar | _on_brick(points))


def _on_brick(points: np.ndarray) -> np.ndarray:
    return np.asarray((np.abs(points[..., 1] - 0.05) < 0.06) & (points[..., 2] > 0.05))


def test_the_part_is_what_is_connected_to_what_is_between_the_pads() -> None:
    merged = _merged()
    parts = held_parts([merged], ON_THE_BRICK.base_from_tcp, 0.04)
    assert parts is not None and np.array_equal(parts[0].target, _on_brick(merged.points_base))


def test_of_one_thing_there_is_no_part() -> None:
    alone = Sight(*seen_from_above((TABLE,), eye_m=EYE_M, target=BRICK))
    assert held_parts([alone], ON_THE_BRICK.base_from_tcp, 0.04) is None


def test_where_nothing_is_seen_between_the_pads_there_is_no_part() -> None:
    assert held_parts([_merged()], grasp(0.30, 0.2, 0.05).base_from_tcp, 0.04) is None


def test_what_the_whole_is_in_the_way_of_is_planned_for_the_part(robot: Robot) -> None:
    merged = _merged()
    whole = Scene.of(robot, STATION, merged)
    with pytest.raises(CycleFailure) as refused:
        plan_pick(whole, [ON_THE_BRICK], CAPTURE)
    assert refused.value.failure is Code.COLLISION and "the target" in refused.value.text

    parts = held_parts([merged], ON_THE_BRICK.base_from_tcp, 0.04)
    assert parts is not None
    part = Scene.of(robot, STATION, *parts)
    plan = plan_pick(whole, [ON_THE_BRICK], CAPTURE, part_of=lambda _: part)
    assert plan.grasp == 0
    for segment in plan.segments:
        q = segment.trajectory.filtered()
        assert part.empty().gate(q, None if segment.name in ("reach", "home") else 0.04) is None, "the pillar stands"
