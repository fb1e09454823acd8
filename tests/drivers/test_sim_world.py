"""The simulated world: gravity, seeds, what is presented, and how closely the arm and hand do what they are told."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from bus.commands import PresentRequest
from bus.errors import ConfigError, HandFault, NotConnected
from bus.messages import ArmMode
from bus.trajectory import TICK_S, Trajectory
from config.load import load_station
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.devices import SimPresenter
from drivers.sim.hand import SimHand
from drivers.sim.placing import OBJECT, Placing
from drivers.sim.world import World

PAPER_OBJECTS = ("bottle", "controller", "cup", "drone", "spatula")


@pytest.fixture(scope="module")
def world() -> World:
    return World(load_station())


@pytest.fixture
def arm(world: World) -> Iterator[SimArm]:
    arm = SimArm(world)
    arm.connect()
    yield arm
    arm.close()


@pytest.fixture
def hand(world: World) -> Iterator[SimHand]:
    hand = SimHand(world)
    hand.connect()
    yield hand
    hand.close()


def there_and_back(q_rad: np.ndarray, by_rad: float, duration_s: float) -> Trajectory:
    phase = np.linspace(0, 2 * np.pi, round(duration_s / TICK_S))
    return Trajectory(raw_q_rad=q_rad + by_rad * ((1 - np.cos(phase)) / 2)[:, None] ** 2, window=64)


# --- objects ----------------------------------------------------------------------------------------------------------


def test_an_object_in_the_air_falls_onto_the_table(world: World) -> None:
    world.present("drone", 1)
    rest_m = world.base_from_object()[2, 3]
    world.data.joint(OBJECT).qpos[2] += 0.2
    heights_m = []
    for _ in range(600):
        world.tick()
        heights_m.append(world.base_from_object()[2, 3])
    ticks = 101
    assert heights_m[0] - heights_m[ticks - 1] == pytest.approx(9.81 * (ticks * TICK_S) ** 2 / 2, abs=2e-3)
    assert heights_m[-1] == pytest.approx(rest_m, abs=5e-3)


@pytest.mark.parametrize("name", PAPER_OBJECTS)
def test_each_object_comes_to_rest_inside_the_pick_region(world: World, name: str) -> None:
    x_min, x_max, y_min, y_max = world.station.scene.pick_region_m
    places = []
    for seed in range(4):
        world.present(name, seed)
        low, high = Placing(world.model, world.data, world.station.scene.pick_region_m).extent()
        assert low[0] >= x_min and high[0] <= x_max and low[1] >= y_min and high[1] <= y_max
        assert abs(low[2]) < 1.5e-3, "it stands on the table"
        before = world.base_from_object()
        for _ in range(500):
            world.tick()
        np.testing.assert_allclose(world.base_from_object(), before, atol=1e-3)
        places.append(before[:2, 3])
    assert np.ptp(places, axis=0).max() > 0.01, "seeds move it"


def test_the_same_seed_gives_the_same_world_to_the_bit() -> None:
    """Not only the pose: half a second of pushing the object with the arm, too."""
    tracks = []
    for _ in range(2):
        world = World(load_station())
        world.present("bottle", 5)
        arm = SimArm(world)
        arm.connect()
        motion = arm.execute(there_and_back(arm.state().q_rad, 0.3, 0.5))
        tracks.append((world.base_from_object(), motion.q_rad, motion.tau_ext_nm))
    for one, other in zip(*tracks, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_presented_pose_does_not_depend_on_what_was_there_before(world: World) -> None:
    world.present("cup", 7)
    first = world.base_from_object()
    world.present("spatula", 1)
    world.present("cup", 3)
    world.present("cup", 7)
    np.testing.assert_allclose(world.base_from_object(), first, atol=1e-6)


def test_each_object_comes_once_a_round(world: World) -> None:
    presenter = SimPresenter(world)
    shown = [presenter.present(PresentRequest(object=None, cycle=cycle, seed=3)).object for cycle in range(5)]
    assert sorted(shown) == sorted(PAPER_OBJECTS)


def test_an_unknown_object_is_refused_with_the_known_ones(world: World) -> None:
    with pytest.raises(ConfigError, match="spatula"):
        world.present("teapot", 1)


def test_presenting_is_quick(world: World) -> None:
    world.present("drone", 1)
    started_s = time.process_time()
    world.present("controller", 2)
    assert time.process_time() - started_s < 1.5


def test_a_folder_without_objects_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"object\.xml"):
        World(load_station(None, [f"sim.objects={tmp_path}"]))


def test_a_broken_object_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thing").mkdir()
    (tmp_path / "thing" / "object.xml").write_text("<mujoco><worldbody><body><geom type='nonsense'/></body>")
    with pytest.raises(ConfigError, match="thing"):
        World(load_station(None, [f"sim.objects={tmp_path}"]))


def test_a_plain_object_of_a_folder_needs_no_joint(tmp_path: Path) -> None:
    """One body, no joint; its own mass; world settings of its file change nothing of ours."""
    (tmp_path / "brick").mkdir()
    (tmp_path / "brick" / "object.xml").write_text(
        "<mujoco><option timestep='0.01' gravity='0 0 0'/><visual><map znear='0.5'/></visual>"
        "<worldbody><light/><body name='brick' pos='1 2 3'><geom type='box' size='.03 .02 .01' mass='0.123'/></body>"
        "</worldbody></mujoco>"
    )
    world = World(load_station(None, [f"sim.objects={tmp_path}"]))
    assert world.names == ("brick",)
    assert world.model.opt.timestep == TICK_S and world.model.opt.gravity[2] == pytest.approx(-9.81)
    assert world.model.body(OBJECT).mass[0] == pytest.approx(0.123)
    assert world.base_from_object()[2, 3] == pytest.approx(0.01, abs=1e-3)


@pytest.mark.parametrize("geom", ["type='sphere' size='.03'", "type='cylinder' size='.02 .03' euler='90 0 0'"])
def test_what_is_round_comes_to_rest(tmp_path: Path, geom: str) -> None:
    """A ball, and a can on its side: rolling friction stops them."""
    (tmp_path / "round").mkdir()
    (tmp_path / "round" / "object.xml").write_text(
        f"<mujoco><worldbody><body><geom {geom} mass='0.1'/></body></worldbody></mujoco>"
    )
    world = World(load_station(None, [f"sim.objects={tmp_path}"]))
    world.present("round", 1)
    before = world.base_from_object()
    for _ in range(1000):
        world.tick()
    np.testing.assert_allclose(world.base_from_object(), before, atol=2e-4)
    world.data.joint(OBJECT).qvel[0] = 0.05
    for _ in range(2000):
        world.tick()
    assert Placing(world.model, world.data, world.station.scene.pick_region_m).rests_inside()


@pytest.mark.parametrize("name", ["mug", "cubemedium", "banana", "hammer", "elephant", "flashlight", "scissors"])
def test_objects_of_a_public_set_load_and_rest(name: str, public_objects: Callable[..., Path]) -> None:
    world = World(load_station(None, [f"sim.objects={public_objects(name)}"]))
    world.present(name, 2)
    assert abs(Placing(world.model, world.data, world.station.scene.pick_region_m).extent()[0, 2]) < 2e-3
    assert 0.02 < world.model.body_subtreemass[world.model.body(OBJECT).id] < 1.5


# --- arm --------------------------------------------------------------------------------------------------------------


def test_at_start_the_arm_is_at_the_capture_pose(world: World, arm: SimArm) -> None:
    np.testing.assert_allclose(arm.state().q_rad, world.station.arm.capture_q_rad, atol=1e-3)
    assert arm.state().mode is ArmMode.IDLE


def test_the_arm_follows_closely_and_rests_within_a_millimetre(world: World, arm: SimArm) -> None:
    start_rad = arm.state().q_rad
    motion = arm.execute(there_and_back(start_rad, 0.3, 1.5))
    commanded = motion.commanded_q_rad[
        np.minimum((motion.t_s / TICK_S).round().astype(int), len(motion.commanded_q_rad) - 1)
    ]
    assert np.abs(motion.q_rad - commanded).max() < 5e-3
    off_rad = arm.state().q_rad - motion.commanded_q_rad[-1]
    reach_m = 0.9
    assert np.abs(off_rad).max() * reach_m < 1e-3
    assert np.abs(arm.state().dq_rad_s).max() < 0.01


def test_a_step_as_short_as_one_tick_leaves_no_offset(arm: SimArm) -> None:
    """The speed that is fed forward must end with the motion."""
    aim_rad = arm.state().q_rad + 5e-4
    arm.execute(Trajectory(raw_q_rad=aim_rad[None], window=1))
    np.testing.assert_allclose(arm.state().q_rad, aim_rad, atol=6e-4)


def test_untouched_the_arm_feels_nothing(arm: SimArm) -> None:
    motion = arm.execute(there_and_back(arm.state().q_rad, 0.1, 1.0))
    assert np.abs(motion.tau_ext_nm.mean(axis=0)).max() < 0.02


def test_a_stop_from_another_thread_ends_the_motion(world: World, arm: SimArm, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = there_and_back(arm.state().q_rad, 0.2, 20.0)
    stopper, ticks, tick = threading.Thread(target=arm.stop), itertools.count(), world.tick

    def tick_and_stop() -> None:
        tick()
        if next(ticks) == 500:
            stopper.start()
            stopper.join(60)

    monkeypatch.setattr(world, "tick", tick_and_stop)
    motion = arm.execute(slow)
    assert not motion.finished
    assert len(motion.commanded_q_rad) < len(slow.raw_q_rad)
    back = Trajectory(raw_q_rad=np.linspace(arm.state().q_rad, slow.start_q_rad, 2000), window=200)
    assert arm.execute(back).finished


def test_nothing_moves_between_calls(world: World, arm: SimArm) -> None:
    """Lockstep: the world stands still while nobody acts."""
    before_s = world.data.time
    arm.state()
    assert world.data.time == before_s


class _Waits:
    """The wall clock of a machine that computes in no time: it goes on while somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.mark.parametrize("pace", [1, 2])
def test_paced_it_takes_its_time(monkeypatch: pytest.MonkeyPatch, pace: int) -> None:
    wall = _Waits()
    arm = SimArm(World(load_station(None, [f"sim.pace={pace}"])))
    arm.connect()
    monkeypatch.setattr("drivers.sim.world.time", wall)
    still = Trajectory(raw_q_rad=np.repeat(arm.state().q_rad[None], 400, axis=0), window=1)
    started_s = wall.now_s
    arm.execute(still)
    assert wall.now_s - started_s == pytest.approx(0.4 / pace, abs=0.02)


# --- hand -------------------------------------------------------------------------------------------------------------


def test_the_hand_moves_at_its_speed(world: World, hand: SimHand) -> None:
    hand.move(0.08, 0.1)
    before_s = world.data.time
    hand.move(0.03, 0.05)
    assert world.data.time - before_s == pytest.approx(1.0, abs=0.25)
    assert hand.state().width_m == pytest.approx(0.03, abs=1e-3)


def test_the_grasp_force_is_what_was_asked(world: World, hand: SimHand) -> None:
    """On the bare fingers: each pad presses the other."""
    hand.move(0.02, 0.1)
    for force_n in (20.0, 40.0):
        hand.grasp(force_n, 0.1)
        pressed_n = -world.data.actuator_force[world.model.actuator("hand").id] / 2
        assert pressed_n == pytest.approx(force_n, rel=0.02)
    hand.move(0.08, 0.1)


@pytest.mark.parametrize("force_n", [0.0, -1.0, float("nan")])
def test_an_impossible_force_is_refused(hand: SimHand, force_n: float) -> None:
    with pytest.raises(HandFault):
        hand.grasp(force_n, 0.1)


def test_arm_and_hand_move_at_the_same_time(world: World, arm: SimArm, hand: SimHand) -> None:
    """Asked from two threads, they share one clock: the fingers move with the arm's ticks, and end with their own."""
    before_s = world.data.time
    still = Trajectory(raw_q_rad=np.repeat(arm.state().q_rad[None], 500, axis=0), window=1)
    closing = threading.Thread(target=hand.move, args=(0.04, 0.05))
    with world.turns.taken():  # the fingers wait for it
        closing.start()
        while not hand.state().is_moving:
            time.sleep(0.001)
    motion = arm.execute(still)
    closing.join()
    assert motion.finished and hand.state().width_m == pytest.approx(0.04, abs=1e-3)
    assert 0.04 / 0.05 < world.data.time - before_s < 0.5 + 0.04 / 0.05
    hand.move(0.08, 0.1)


# --- life cycle -------------------------------------------------------------------------------------------------------


def test_before_connect_every_device_says_so(world: World) -> None:
    for call in (SimArm(world).state, SimHand(world).state, SimCamera(world).capture):
        with pytest.raises(NotConnected, match="connect"):
            call()


def test_close_is_idempotent_and_allowed_before_connect(world: World) -> None:
    for device in (SimArm(world), SimHand(world), SimCamera(world)):
        device.close()
        device.connect()
        device.close()
        device.close()
