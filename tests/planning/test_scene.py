"""Paths among obstacles: nothing is missed between two checks; what is held counts as part of the hand."""

from __future__ import annotations

import numpy as np
import pytest

from config.limits import LOWER_RAD, UPPER_RAD
from config.scene import Box
from planning.height_field import Sight
from planning.robot import Robot
from planning.scene import Scene
from planning.travel import sweep_m
from tests.planning.conftest import CAPTURE, STATION, WIDE_M, among, box
from tests.planning.views import seen_from_above

ACROSS = CAPTURE + np.array([1.0, 0, 0, 0, 0, 0, 0])
SPREAD = [0.5, 0.5, 0.3, 0.5, 0.4, 0.5, 0.8]
BRUTE_M = 0.0005


def edges(count: int, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    ends = np.clip(CAPTURE + rng.normal(0, SPREAD, (count, 2, 7)), LOWER_RAD + 0.1, UPPER_RAD - 0.1)
    return list(ends)


def brute_force(scene: Scene, edge: np.ndarray, step_m: float = BRUTE_M) -> bool:
    """Whether anything is touched by the exact meshes, without margins, checked every half millimetre of movement."""
    steps = int(np.ceil(sweep_m(scene.robot, edge)[-1] / step_m)) + 1
    return any(scene._exact.collision(q, WIDE_M) is not None for q in np.linspace(edge[0], edge[1], steps))


def plate_in_the_way(robot: Robot, edge: np.ndarray, rng: np.random.Generator) -> Box:
    """A plate 5 mm thick across where some part of the hand passes."""
    middle = robot.base_from_tcp(edge[0] + rng.uniform(0.2, 0.8) * (edge[1] - edge[0]))
    size = np.full(3, 0.03)
    size[rng.integers(3)] = 0.005
    center = middle[:3, 3] + middle[:3, :3] @ rng.uniform([-0.02, -0.05, -0.08], [0.02, 0.05, 0.01])
    return box("plate", tuple(center.tolist()), tuple(size.tolist()))


def test_a_crumb_on_the_way_is_found(robot: Robot, scene: Scene) -> None:
    middle = robot.base_from_tcp(CAPTURE + np.array([0.5, 0, 0, 0, 0, 0, 0]))[:3, 3]
    crowded = among(robot, box("crumb", tuple(middle.tolist()), (0.001, 0.001, 0.001)))
    ends = np.stack([CAPTURE, ACROSS])
    assert crowded.collision(CAPTURE, WIDE_M) is None
    assert crowded.collision(ACROSS, WIDE_M) is None
    assert scene.first_collision(ends, WIDE_M) is None
    assert "touches crumb" in str(crowded.first_collision(ends, WIDE_M))


def test_no_thin_plate_is_missed_between_two_checks(robot: Robot) -> None:
    rng = np.random.default_rng(7)
    hit = 0
    for edge in edges(40, seed=8):
        crowded = among(robot, plate_in_the_way(robot, edge, rng))
        if brute_force(crowded, edge, step_m=0.002):
            hit += 1
            assert crowded.first_collision(edge, WIDE_M) is not None
    assert hit > 20


def test_a_path_of_one_point_is_checked_too(robot: Robot) -> None:
    crowded = among(robot, box("block", (0.375, 0.0, 0.6), (0.3, 0.3, 0.1)))
    assert "touches block" in str(crowded.first_collision(CAPTURE[None], WIDE_M))


def test_the_gate_judges_by_itself(robot: Robot) -> None:
    block = box("block", (0.15, 0.35, 0.55), (0.05, 0.05, 0.3))
    commands = np.linspace(CAPTURE, CAPTURE + np.array([1.5, 0, 0, 0, 0, 0, 0]), 1500)
    assert "touches block" in str(among(robot, block).gate(commands, WIDE_M))
    assert among(robot).gate(commands, WIDE_M) is None


def held_plank(robot: Robot, *obstacles: Box) -> tuple[Scene, Scene]:
    """The scene with a plank below the hand at the capture pose, lying there and held."""
    tcp = robot.base_from_tcp(CAPTURE)
    grid = np.stack(np.meshgrid(np.linspace(-0.15, 0.15, 31), np.linspace(-0.02, 0.02, 5)), axis=-1).reshape(-1, 2)
    points = np.concatenate([grid + tcp[:2, 3], np.full((len(grid), 1), tcp[2, 3])], axis=1)
    lying = Scene(robot, STATION, (*among(robot, *obstacles).boxes,), target=points)
    return lying, lying.holding(tcp)


def test_what_is_held_moves_with_the_hand_and_may_touch_it(robot: Robot) -> None:
    _, holding = held_plank(robot)
    for turn in (0.0, 0.4, 0.9):
        q = CAPTURE + np.array([turn, 0, 0, 0, 0, 0, 0])
        assert holding.empty().collision(q, 0.04) is None


def test_what_is_held_touches_what_the_hand_alone_passes(robot: Robot) -> None:
    tcp = robot.base_from_tcp(CAPTURE)[:3, 3]
    post = box("post", (tcp[0] + 0.13, tcp[1] + 0.12, 0.3), (0.02, 0.02, 0.6))
    lying, holding = held_plank(robot, post)
    over = np.stack([CAPTURE, CAPTURE + np.array([0.5, 0, 0, 0, 0, 0, 0])])
    assert lying.empty().first_collision(over, 0.04) is None
    touched = holding.first_collision(over, 0.04)
    assert str(touched) == "post touches held object"
    assert touched is not None and touched.by_hand, "no other arm configuration frees what hangs in the hand"


def test_what_is_held_has_the_shape_that_all_looks_show(robot: Robot) -> None:
    """A post with a low foot on its right: from the left, the post hides the foot."""
    post = box("target", (0.45, 0.0, 0.10), (0.06, 0.06, 0.20))
    foot = box("target", (0.45, -0.06, 0.015), (0.06, 0.06, 0.03))
    left, right = (_sight_of((post, foot), (0.45, y, 0.8)) for y in (0.55, -0.55))
    reaches_m = [
        Scene.of(robot, STATION, *sights).target for sights in ((left,), (right,), (left, right), (right, left))
    ]
    lowest_y = [float(target[:, 1].min()) for target in reaches_m if target is not None]
    assert lowest_y == pytest.approx([-0.03, -0.09, -0.09, -0.09], abs=0.006)
    highest_y = [float(target[:, 1].max()) for target in reaches_m if target is not None]
    assert highest_y == pytest.approx(4 * [0.03], abs=0.006)
    assert Scene.of(robot, STATION, left, right).field is None, "all of it is the target"


def _sight_of(target: tuple[Box, ...], eye_m: tuple[float, float, float]) -> Sight:
    """The sight of a target made of boxes."""
    points, _ = seen_from_above((STATION.scene.table, *target), eye_m=eye_m)
    ours = [(np.abs(points - one.center_m) < np.array(one.size_m) / 2 + 1e-3).all(axis=-1) for one in target]
    return Sight(points, np.logical_or.reduce(ours) & (points[..., 2] > 1e-3))


def test_only_the_fingers_may_touch_the_target(robot: Robot) -> None:
    tcp = robot.base_from_tcp(CAPTURE)
    tower = np.array([[dx, dy, 0.08] for dx in (-0.02, 0.02) for dy in (-0.02, 0.02)] * 8) + tcp[:3, 3]
    scene = Scene(robot, STATION, among(robot).boxes, target=tower)
    assert str(scene.collision(CAPTURE, WIDE_M)) == "hand touches the target"
    assert Scene(robot, STATION, among(robot).boxes, target=tower - [0, 0, 0.08]).collision(CAPTURE, WIDE_M) is None


def test_on_the_way_to_the_approach_line_the_fingers_keep_off_it_too(robot: Robot) -> None:
    tip_m = robot.base_from_tcp(CAPTURE)[:3, 3]
    pole = tip_m + [[x, y, z] for x in (0.0, 0.01) for y in (0.03, 0.05) for z in np.linspace(-0.3, 0.0, 10)]
    scene = Scene(robot, STATION, among(robot).boxes, target=pole)
    assert scene.collision(CAPTURE, WIDE_M) is None
    assert "finger touches the target" in str(scene.on_the_way().collision(CAPTURE, WIDE_M))
    assert scene.on_the_way().empty().collision(CAPTURE, WIDE_M) is None


def test_clutter_that_is_only_seen_is_kept_away_from(robot: Robot) -> None:
    tcp = robot.base_from_tcp(CAPTURE + np.array([0.5, 0, 0, 0, 0, 0, 0]))[:3, 3]
    post = box("post", (tcp[0], tcp[1], tcp[2] / 2), (0.03, 0.03, tcp[2]))
    points, target = seen_from_above((STATION.scene.table, post), eye_m=(0.45, 0.0, 1.5))
    scene = Scene.of(robot, STATION, Sight(points, target))
    ends = np.stack([CAPTURE, ACROSS])
    assert "touches an observed obstacle" in str(scene.first_collision(ends, WIDE_M))
    assert "touches an observed obstacle" in str(scene.gate(np.linspace(ends[0], ends[1], 1000), WIDE_M))
