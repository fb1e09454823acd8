"""Several objects between walls: what counts as an object, what as empty, and what was cleared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import mujoco
import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Observation
from cell.pick.capture import capture
from config.franka_hand import FINGER_TIP_M, PALM_ABOVE_TIP_M
from config.load import DEFAULT_STATION, load_station
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.world import World
from perception.detector import detect, ignore_reply
from perception.grasps.closing import OVER_M
from perception.models import open_models
from perception.scene.change import cleared_fraction
from perception.scene.gone import others_gone
from perception.scene.scene import Scene, observe
from perception.scene.seen import RegionView, require_something
from planning.kinematics import inverse, q7_grid
from planning.robot import Robot, flange_pose
from planning.scene import Scene as Surroundings

BIN_STATION = DEFAULT_STATION.with_name("bin.toml")
SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (1, 2))]


class Bin:
    """A filled bin under the camera; objects can be taken away by hand."""

    def __init__(self, seed: int, *, clutter: int = 5, wall_height_m: float = 0.045) -> None:
        wall = f"{{name='bin', center_m=[0.46, 0], size_m=[0.41, 0.545], wall_height_m={wall_height_m}}}"
        options = [f"sim.seed={seed}", f"sim.clutter={clutter}", f"scene.bins=[{wall}]"]
        self.station = load_station(BIN_STATION, options)
        self.world = World(self.station)
        self.camera, self.arm, self.robot = SimCamera(self.world), SimArm(self.world), Robot(self.station)
        self.scene = Surroundings.of(self.robot, self.station)
        self.camera.connect()
        self.arm.connect()

    def look(self) -> Observation:
        return capture(self.camera, self.arm, self.robot)

    def observed(self) -> Scene:
        return observe(self.look(), self.station)

    def nearest(self, place_m: np.ndarray) -> str:
        """The body whose origin is nearest to a place (x, y)."""
        return min(
            self.world.objects, key=lambda body: float(np.hypot(*(self.world.data.body(body).xpos[:2] - place_m)))
        )

    def take_away(self, body: str) -> None:
        self.world.data.joint(body).qpos[2] = -5.0
        mujoco.mj_forward(self.world.model, self.world.data)


@pytest.fixture
def filled() -> Iterator[Callable[..., Bin]]:
    """Makes bins, and closes their cameras."""
    with ExitStack() as stack:

        def make(*seed: int, **how: Any) -> Bin:
            bin_ = Bin(*seed, **how)
            stack.callback(bin_.camera.close)
            return bin_

        yield make


@pytest.mark.parametrize("seed", SEEDS)
def test_no_thing_is_of_two_objects_or_of_a_wall_and_hardly_an_object_is_two(
    filled: Callable[..., Bin], seed: int
) -> None:
    """The remote's ring, of another colour than its handle, may be a thing of its own."""
    bin_ = filled(seed)
    scene = bin_.observed()
    points = scene.view.points_base
    middles = [points[scene.labels == number].mean(axis=0)[:2] for number in range(1, scene.count + 1)]
    assert {bin_.nearest(middle) for middle in middles} == set(bin_.world.objects)
    assert len(middles) <= len(bin_.world.objects) + 1


@pytest.mark.parametrize("wall_height_m", [0.045, 0.08])
@pytest.mark.parametrize("seed", SEEDS)
def test_walls_alone_are_an_empty_bin(filled: Callable[..., Bin], seed: int, wall_height_m: float) -> None:
    bin_ = filled(seed, clutter=1, wall_height_m=wall_height_m)
    bin_.take_away("object-0")
    for _ in range(3):
        with pytest.raises(CycleFailure) as failure:
            scene = bin_.observed()
            require_something(scene, RegionView.of(scene, bin_.station), bin_.station)
        assert failure.value.failure is Code.NO_OBJECT


@pytest.mark.parametrize("seed", SEEDS)
def test_a_place_is_cleared_when_its_object_left_whatever_the_neighbours_do(
    filled: Callable[..., Bin], seed: int
) -> None:
    bin_ = filled(seed)
    before = bin_.look()
    found = detect(before, bin_.station, open_models(bin_.station, {}), ignore_reply)
    target = bin_.nearest(found.grasps[0].base_from_tcp[:2, 3])
    other = next(body for body in bin_.world.objects if body != target)
    bin_.take_away(other)
    still = cleared_fraction(found, found.grasps[0].instance, before, bin_.look(), bin_.station)
    assert still is not None and still < 0.3, "another one left, not this one"
    bin_.take_away(target)
    gone = cleared_fraction(found, found.grasps[0].instance, before, bin_.look(), bin_.station)
    assert gone is not None and gone > 0.9


def test_where_detection_lets_the_palm_pass_the_planner_does_too(filled: Callable[..., Bin]) -> None:
    """The lowest tcp over a wall that detection allows: the planner's hand clears the wall."""
    bin_ = filled(0, clutter=1, wall_height_m=0.08)
    tcp_m = bin_.station.scene.bins[0].wall_height_m + OVER_M - PALM_ABOVE_TIP_M + FINGER_TIP_M + 1e-3
    base_from_tcp = np.diag([1.0, -1.0, -1.0, 1.0])  # closes along y, the palm over the left wall
    base_from_tcp[:3, 3] = 0.46, 0.2, tcp_m
    touches = [bin_.scene.collision(q_rad, 0.08) for q_rad in inverse(flange_pose(base_from_tcp), q7_grid())]
    assert None in touches
    base_from_tcp[2, 3] -= 0.006
    touches = [bin_.scene.collision(q_rad, 0.08) for q_rad in inverse(flange_pose(base_from_tcp), q7_grid())]
    assert touches and None not in touches


def test_of_the_others_only_those_that_were_taken_away_are_gone_not_what_was_moved(
    filled: Callable[..., Bin],
) -> None:
    bin_ = filled(0)
    before = bin_.look()
    found = detect(before, bin_.station, open_models(bin_.station, {}), ignore_reply)
    picked = found.grasps[0]
    target = bin_.nearest(picked.base_from_tcp[:2, 3])
    free_m = bin_.world.data.joint(target).qpos[:2].copy()
    far_m = {body: np.hypot(*(bin_.world.data.joint(body).qpos[:2] - free_m)) for body in bin_.world.objects}
    _, moved, *_, taken = sorted(far_m, key=lambda body: float(far_m[body]))
    bin_.take_away(target)
    assert others_gone(found, picked.instance, before, bin_.look(), bin_.station).gone == ()
    lay_m, lay_taken_m = (bin_.world.data.joint(body).qpos[:2].copy() for body in (moved, taken))
    bin_.world.data.joint(moved).qpos[:2] += 0.1 * (free_m - lay_m) / np.hypot(*(free_m - lay_m))
    bin_.take_away(taken)
    gone = others_gone(found, picked.instance, before, bin_.look(), bin_.station).gone
    places_m = [one.top_m[:2] for one in found.scene.instances if one.number in gone]
    assert places_m and all(np.hypot(*(place_m - lay_taken_m)) < 0.1 for place_m in places_m)
