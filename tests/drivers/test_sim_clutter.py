"""A pick region filled once with several objects: seeded, at rest, inside, apart or heaped; walls in both worlds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus.commands import PresentRequest
from bus.errors import ConfigError
from config.load import DEFAULT_STATION, load_station
from drivers.sim.clutter import APART_M, least_gap_m
from drivers.sim.devices import SimPresenter
from drivers.sim.placing import Placing
from drivers.sim.world import World
from planning.kinematics import inverse, q7_grid
from planning.robot import Robot, flange_pose
from planning.scene import Scene

BIN_STATION = DEFAULT_STATION.with_name("bin.toml")
PAPER_OBJECTS = ("bottle", "controller", "cup", "drone", "spatula")


def filled(seed: int, clutter: int = 5) -> World:
    return World(load_station(BIN_STATION, [f"sim.seed={seed}", f"sim.clutter={clutter}"]))


def heaped(seed: int, clutter: int, station: Path = BIN_STATION) -> World:
    return World(load_station(station, [f"sim.seed={seed}", f"sim.clutter={clutter}", "sim.heaped=true"]))


def placings(world: World) -> list[Placing]:
    return [Placing(world.model, world.data, world.station.scene.pick_region_m, body) for body in world.objects]


@pytest.fixture(scope="module")
def world() -> World:
    return filled(3)


def poses(world: World) -> list[np.ndarray]:
    return [one.base_from_object for one in SimPresenter(world).truth().objects]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (1, 2, 3))])
def test_every_object_lies_inside_at_rest_and_apart(seed: int) -> None:
    world = filled(seed)
    x_min, x_max, y_min, y_max = world.station.scene.pick_region_m
    before = poses(world)
    for placing in placings(world):
        low, high = placing.extent()
        assert low[0] >= x_min and high[0] <= x_max and low[1] >= y_min and high[1] <= y_max
        assert abs(low[2]) < 1.5e-3, "it stands on the table"
    assert least_gap_m(placings(world)) > APART_M / 2
    for _ in range(500):
        world.tick()
    np.testing.assert_allclose(poses(world), before, atol=1e-3)


def test_the_same_seed_fills_alike_to_the_bit_and_another_one_does_not() -> None:
    first, again, other = filled(1, 3), filled(1, 3), filled(2, 3)
    np.testing.assert_array_equal(poses(first), poses(again))
    assert not np.allclose(poses(first), poses(other))


def test_names_come_once_a_round_and_repeat_when_there_are_more() -> None:
    six = list(filled(5, 6).objects.values())
    assert sorted(six[:5]) == sorted(PAPER_OBJECTS) and six[5] in PAPER_OBJECTS


def test_a_new_cycle_leaves_everything_as_it_is(world: World) -> None:
    presenter, before = SimPresenter(world), poses(world)
    for cycle in range(3):
        shown = presenter.present(PresentRequest(object=None, cycle=cycle, seed=3))
        np.testing.assert_array_equal([one.base_from_object for one in shown.objects], before)


def test_the_truth_names_them_all_and_there_is_no_only_one(world: World) -> None:
    truth = SimPresenter(world).truth()
    assert sorted(one.name for one in truth.objects) == sorted(PAPER_OBJECTS)
    with pytest.raises(ValueError, match="too many"):
        _ = truth.object


def test_an_object_by_name_is_refused(world: World) -> None:
    with pytest.raises(ConfigError, match="filled"):
        SimPresenter(world).present(PresentRequest(object="cup", cycle=0, seed=3))
    with pytest.raises(ConfigError, match="clutter"):
        world.present("cup", 3)


def test_a_heap_of_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match="set clutter"):
        load_station(None, ["sim.heaped=true"])


@pytest.mark.parametrize(
    ("station", "clutter"),
    [(BIN_STATION, 10), (DEFAULT_STATION, 6), pytest.param(BIN_STATION, 30, marks=pytest.mark.thorough)],
)
def test_the_objects_of_a_heap_touch_lie_on_one_another_and_rest_inside(station: Path, clutter: int) -> None:
    world = heaped(1, clutter, station)
    assert least_gap_m(placings(world)) < 0, "seen from above, some hide others"
    bodies = {world.model.body(body).id for body in world.objects}
    touching = [
        {int(world.model.body_rootid[world.model.geom_bodyid[geom]]) for geom in contact.geom}
        for contact in world.data.contact
    ]
    assert any(len(pair) == 2 and pair <= bodies for pair in touching), "some lean on others"
    before = poses(world)
    x_min, x_max, y_min, y_max = world.station.scene.pick_region_m
    for placing in placings(world):
        x, y, z = placing.extent().mean(axis=0)
        assert x_min < x < x_max and y_min < y < y_max and z > 0
    for _ in range(300):
        world.tick()
    np.testing.assert_allclose(poses(world), before, atol=0.02)


def test_the_same_seed_heaps_alike_to_the_bit_and_another_one_does_not() -> None:
    first, again, other = heaped(1, 5), heaped(1, 5), heaped(2, 5)
    np.testing.assert_array_equal(poses(first), poses(again))
    assert not np.allclose(poses(first), poses(other))


def test_more_than_the_bin_holds_is_refused() -> None:
    with pytest.raises(ConfigError, match="12 objects do not fit"):
        filled(0, 12)


def test_an_object_falls_against_the_walls_and_stays_inside(world: World) -> None:
    """The walls are solid: what is pushed at them stops."""
    body = next(body for body, name in world.objects.items() if name == "cup")
    start = world.data.joint(body).qpos.copy()
    world.data.joint(body).qpos[:2] = 0.46, 0.20
    world.data.joint(body).qvel[1] = 1.0
    for _ in range(800):
        world.tick()
    assert world.base_from_object(body)[1, 3] < 0.26
    world.data.joint(body).qpos[:], world.data.joint(body).qvel[:] = start, 0.0


def test_the_planner_sees_the_wall_that_the_simulation_builds(world: World) -> None:
    """A hand that reaches through the right wall, a hand in the middle of the bin."""
    scene = Scene.of(Robot(world.station), world.station)
    assert {f"bin-{side}" for side in ("front", "back", "right", "left")} <= {
        world.model.geom(index).name for index in range(world.model.ngeom)
    }
    for y_m, touches in ((-0.22, "bin-right"), (0.0, None)):
        base_from_tcp = np.diag([1.0, -1.0, -1.0, 1.0])
        base_from_tcp[:3, 3] = 0.46, y_m, 0.03
        found = [scene.collision(q_rad, 0.08) for q_rad in inverse(flange_pose(base_from_tcp), q7_grid())]
        if touches is None:
            assert None in found
        else:
            assert all(collision is not None for collision in found) and any(
                touches in str(collision) for collision in found
            )
