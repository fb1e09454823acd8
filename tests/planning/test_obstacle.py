"""What was in the way of a rejected grasp: which thing, where, and by how much too near."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from bus.errors import CycleFailure
from bus.messages import Grasp
from bus.rejection import Obstacle, Rejection
from config.pick import PlanningSettings
from config.scene import Box, SceneSettings
from config.schema import Station
from planning.height_field import Sight
from planning.pick import plan_pick
from planning.robot import Robot
from planning.scene import Scene
from tests.planning.conftest import CAPTURE, NODES, STATION, box
from tests.planning.test_pick import grasp
from tests.planning.views import seen_from_above

AT = grasp(0.45, 0.0, 0.04)
"""It closes along y; opened 60 mm wide, the fingers reach from 30 to 45 mm beside its middle."""
FROM_ABOVE = PlanningSettings(tilts_deg=(0.0,))
POST = box("post", (0.45, 0.04, 0.05), (0.01, 0.01, 0.1))
BY_HAND_M = 0.0452 - (0.035 - 0.002)
"""From the finger's outer face to 2 mm before the post: the shortest way out, back along the closing axis."""


def in_the_way(scene: Scene) -> Obstacle:
    """Of the grasp, from straight above."""
    (first,) = rejected(scene, AT)
    assert first.obstacle is not None
    return first.obstacle


def rejected(scene: Scene, *grasps: Grasp) -> Sequence[Rejection]:
    with pytest.raises(CycleFailure) as failure:
        plan_pick(scene, grasps, CAPTURE)
    return failure.value.rejected


def among(robot: Robot, *obstacles: Box) -> Scene:
    return Scene.of(robot, Station(nodes=NODES, scene=SceneSettings(obstacles=obstacles), planning=FROM_ABOVE))


def seen(robot: Robot) -> Scene:
    """The same post, not known but seen from above."""
    view = seen_from_above((STATION.scene.table, POST), eye_m=(0.45, 0.0, 1.2))
    return Scene.of(robot, Station(nodes=NODES, planning=FROM_ABOVE), Sight(*view))


def test_a_known_box_is_named_with_its_corners_and_the_way_out_is_measured(robot: Robot) -> None:
    found = in_the_way(among(robot, POST))
    assert (found.name, found.kind, found.needed_m, found.opening_m) == ("post", "box", 0.002, 0.06)
    assert found.part in ("left finger", "right finger")
    assert found.too_near_m == pytest.approx(BY_HAND_M, abs=0.003)
    np.testing.assert_allclose(np.ptp(found.points_m, axis=0), POST.size_m, atol=1e-6)
    np.testing.assert_allclose(found.touch_m[:2], POST.center_m[:2], atol=0.006)
    np.testing.assert_allclose(found.base_from_tcp[:3, 3], AT.base_from_tcp[:3, 3], atol=1e-4)


def test_what_was_only_seen_is_shown_by_its_points(robot: Robot) -> None:
    found = in_the_way(seen(robot))
    assert (found.name, found.kind) == ("an observed obstacle", "seen")
    assert found.too_near_m is not None and 0 < found.too_near_m < BY_HAND_M + 0.008, "a cell more than the post"
    assert 0 < len(found.points_m) <= 150
    np.testing.assert_allclose(found.touch_m[:2], POST.center_m[:2], atol=0.011)


def test_the_same_inputs_give_the_same_bits(robot: Robot) -> None:
    one, other = (in_the_way(among(robot, POST)) for _ in range(2))
    assert one.model_dump_json() == other.model_dump_json()


def test_a_grasp_out_of_reach_has_nothing_in_its_way(scene: Scene) -> None:
    assert all(one.obstacle is None for one in rejected(scene, grasp(1.2, 0.0, 0.05)))


def test_nothing_is_measured_where_another_grasp_is_feasible(robot: Robot) -> None:
    plan = plan_pick(among(robot, POST), [AT, grasp(0.45, -0.15, 0.04)], CAPTURE)
    assert plan.rejected[0].grasp == 0 and plan.rejected[0].obstacle is None
