"""Grasping in the simulated cell is physics: friction holds, and nothing else does.

The grasps are scripted from the object's true pose; inverse kinematics is plain damped least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import pytest
from scipy.interpolate import CubicSpline

from bus.commands import PresentRequest
from bus.trajectory import TICK_S, Trajectory
from config.load import load_station
from config.schema import Station
from drivers.interface import Arm, Devices, Hand, ObjectPresenter
from drivers.sim.devices import open_devices

Array = npt.NDArray[np.float64]
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class Grip:
    """Where to hold an object from above: a point and the closing axis in its own frame, a height over the table."""

    at_m: tuple[float, float, float]
    closing: tuple[float, float, float]
    height_m: float
    opening_m: float
    width_m: float
    mass_kg: float


GRIPS = {
    "bottle": Grip((-0.010, 0, 0), (0, 1, 0), 0.030, 0.075, 0.060, 0.30),
    "controller": Grip((-0.040, 0, 0), (0, 1, 0), 0.018, 0.060, 0.036, 0.16),
    "cup": Grip((0, 0, 0), (0, 1, 0), 0.055, 0.078, 0.066, 0.22),
    "drone": Grip((0, 0, 0), (0, 1, 0), 0.026, 0.065, 0.044, 0.25),
    "spatula": Grip((-0.040, 0, 0), (0, 1, 0), 0.012, 0.045, 0.020, 0.12),
}
GATE = ("cup", "spatula")
OBJECTS = [*GATE, *(pytest.param(name, marks=pytest.mark.thorough) for name in sorted(GRIPS.keys() - set(GATE)))]


class Kinematics:
    """The tcp of the FR3, from its URDF."""

    def __init__(self) -> None:
        self._model = pin.buildModelFromUrdf(str(Path(str(files("franky_sim"))) / "assets" / "fr3.urdf"))
        self._data = self._model.createData()
        self._tcp = self._model.getFrameId("fr3_hand_tcp")

    def base_from_tcp(self, q_rad: Array) -> pin.SE3:
        pin.framesForwardKinematics(self._model, self._data, np.append(q_rad, [0.0, 0.0]))
        return self._data.oMf[self._tcp].copy()

    def jacobian(self, q_rad: Array) -> Array:
        """(6, 7) in ``base`` axes."""
        q = np.append(q_rad, [0.0, 0.0])
        whole: Array = pin.computeFrameJacobian(self._model, self._data, q, self._tcp, pin.LOCAL_WORLD_ALIGNED)
        return whole[:, :7]

    def inverse(self, base_from_tcp: Array, q_rad: Array) -> Array:
        goal, q_rad = pin.SE3(base_from_tcp), np.array(q_rad)
        for _ in range(300):
            now = self.base_from_tcp(q_rad)
            error = np.append(goal.translation - now.translation, pin.log3(goal.rotation @ now.rotation.T))
            if np.abs(error).max() < 1e-7:
                return q_rad
            jacobian = self.jacobian(q_rad)
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-5 * np.eye(6), error)
            q_rad = q_rad + step.clip(-0.2, 0.2)
        raise AssertionError("the scripted pose is out of reach")


def through(points: Array, duration_s: float) -> Trajectory:
    """A smooth motion through joint positions (n, 7), at rest at both ends."""
    share = np.linspace(0, 1, round(duration_s / TICK_S))
    spline = CubicSpline(np.linspace(0, 1, len(points)), points)
    return Trajectory(raw_q_rad=spline(10 * share**3 - 15 * share**4 + 6 * share**5), window=32)


def resting(q_rad: Array, duration_s: float) -> Trajectory:
    return Trajectory(raw_q_rad=np.repeat(q_rad[None], round(duration_s / TICK_S), axis=0), window=1)


def from_above(base_from_object: Array, grip: Grip) -> Array:
    """The tcp pose that holds the object by ``grip``, with the wrist turned the shorter way."""
    closing = base_from_object[:3, :3] @ np.array(grip.closing, dtype=float)
    closing = np.append(closing[:2], 0.0) / np.linalg.norm(closing[:2])
    down = np.array([0.0, 0.0, -1.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = np.cross(closing, down), closing, down
    pose[:3, :2] *= 1.0 if pose[0, 0] > 0 else -1.0
    pose[:3, 3] = base_from_object[:3, 3] + base_from_object[:3, :3] @ np.array(grip.at_m)
    pose[2, 3] = grip.height_m
    return pose


def raised(pose: Array, by_m: float) -> Array:
    higher = np.array(pose)
    higher[2, 3] += by_m
    return higher


@dataclass(frozen=True)
class Lift:
    """The result of a scripted pick."""

    closed_m: float
    rise_m: float
    rise_after_hold_m: float
    held_width_m: float
    creep_m: float
    load_n: float


class Cell:
    """The simulated arm, hand and object presenter, and one scripted pick with them."""

    def __init__(self, station: Station) -> None:
        devices: Devices = open_devices(station)
        assert devices.arm is not None and devices.hand is not None and devices.presenter is not None
        self.arm: Arm = devices.arm
        self.hand: Hand = devices.hand
        self.presenter: ObjectPresenter = devices.presenter
        self.home_rad = np.array(station.arm.capture_q_rad)
        self.kinematics = Kinematics()
        self.arm.connect()
        self.hand.connect()

    def height_m(self) -> float:
        return float(self.presenter.truth().base_from_object[2, 3])

    def in_hand_m(self) -> Array:
        """Position of the object in the tcp."""
        tcp = self.kinematics.base_from_tcp(self.arm.state().q_rad)
        return np.asarray(tcp.actInv(self.presenter.truth().base_from_object[:3, 3]))

    def upright_line(self, pose: Array, from_m: float, to_m: float, q_rad: Array) -> Array:
        """Joint positions along the vertical through ``pose``, from one height above it to another."""
        line = []
        for height_m in np.linspace(from_m, to_m, 13):
            q_rad = self.kinematics.inverse(raised(pose, height_m), q_rad)
            line.append(q_rad)
        return np.array(line)

    def pick(self, name: str, grip: Grip, seed: int = 1) -> Lift:
        """Present, grasp from above, lift by 0.15 m, hold for 3 s; then let go and come home."""
        truth = self.presenter.present(PresentRequest(object=name, cycle=0, seed=seed)).base_from_object
        grasp = from_above(truth, grip)
        down = self.upright_line(grasp, 0.10, 0.0, self.home_rad)
        up = self.upright_line(grasp, 0.0, 0.15, down[-1])
        self.hand.move(grip.opening_m, 0.1)
        self.arm.execute(through(np.array([self.arm.state().q_rad, down[0]]), 1.5))
        self.arm.execute(through(down, 1.0))
        closed_m = self.hand.grasp(30.0, 0.05).width_m
        self.arm.execute(through(up, 1.0))
        rise_m, in_hand_m = self.height_m() - truth[2, 3], self.in_hand_m()
        hold = self.arm.execute(resting(up[-1], 3.0))
        jacobian = self.kinematics.jacobian(up[-1])
        force_n = np.linalg.lstsq(jacobian.T, hold.tau_ext_nm.mean(axis=0))[0][2]
        lift = Lift(
            closed_m=closed_m,
            rise_m=rise_m,
            rise_after_hold_m=self.height_m() - truth[2, 3],
            held_width_m=self.hand.state().width_m,
            creep_m=float(np.linalg.norm(self.in_hand_m() - in_hand_m)),
            load_n=-float(force_n),
        )
        self.hand.move(0.08, 0.1)
        self.arm.execute(through(np.array([self.arm.state().q_rad, self.home_rad]), 1.5))
        return lift


@pytest.fixture(scope="module")
def rough() -> Cell:
    """Finger pads of friction 0.8."""
    return Cell(load_station())


@pytest.fixture(scope="module")
def slippery() -> Cell:
    """Finger pads without friction."""
    return Cell(load_station(None, ["sim.friction=0"]))


@pytest.fixture(autouse=True)
def _tidy(request: pytest.FixtureRequest) -> Iterator[None]:
    """After a failed script the next one starts from home again."""
    yield
    for name in {"rough", "slippery"} & set(request.fixturenames):
        cell: Cell = request.getfixturevalue(name)
        assert np.abs(cell.arm.state().q_rad - cell.home_rad).max() < 0.01


@pytest.mark.parametrize("name", OBJECTS)
def test_friction_lifts_and_holds_each_object(rough: Cell, name: str) -> None:
    grip = GRIPS[name]
    lift = rough.pick(name, grip)
    assert lift.closed_m == pytest.approx(grip.width_m, abs=1e-3)
    assert lift.rise_m == pytest.approx(0.15, abs=5e-3)
    assert lift.rise_after_hold_m == pytest.approx(lift.rise_m, abs=1e-3)
    assert lift.held_width_m == pytest.approx(lift.closed_m, abs=1e-3)
    assert lift.creep_m < 1e-3
    assert lift.load_n == pytest.approx(grip.mass_kg * GRAVITY_M_S2, rel=0.1, abs=0.1)


@pytest.mark.parametrize("name", OBJECTS)
def test_without_friction_every_object_stays_behind(slippery: Cell, name: str) -> None:
    grip = GRIPS[name]
    lift = slippery.pick(name, grip)
    assert lift.closed_m == pytest.approx(grip.width_m, abs=1e-3), "the fingers did meet the object"
    assert lift.rise_after_hold_m < 5e-3
    assert lift.held_width_m < 2e-3
    assert abs(lift.load_n) < 0.1


@pytest.mark.parametrize(
    "height_m", [0.016, *(pytest.param(one, marks=pytest.mark.thorough) for one in (0.0125, 0.024))]
)
def test_without_friction_no_height_cages_a_round_object(slippery: Cell, height_m: float) -> None:
    """Flat jaws meet a round object at its widest, however low they reach: nothing carries it from below."""
    low = Grip((-0.040, 0, 0), (0, 1, 0), height_m, 0.060, 0.036, 0.16)
    assert slippery.pick("controller", low).rise_after_hold_m < 5e-3


def test_the_weight_limit_is_friction(rough: Cell) -> None:
    """With a fraction of the force the same grip no longer carries the bottle."""
    weak = Cell(load_station(None, ["sim.friction=0.03"]))
    assert weak.pick("bottle", GRIPS["bottle"]).rise_after_hold_m < 5e-3  # 2 x 0.03 x 30 N < 2.9 N


def test_an_opened_hand_drops_what_it_holds(rough: Cell) -> None:
    rough.pick("drone", GRIPS["drone"])  # opens the hand at its end, 0.15 m up
    assert rough.height_m() < 0.03


def test_a_stopped_hand_keeps_its_grip(rough: Cell) -> None:
    truth = rough.presenter.present(PresentRequest(object="drone", cycle=0, seed=1)).base_from_object
    pose = from_above(truth, GRIPS["drone"])
    down = rough.upright_line(pose, 0.10, 0.0, rough.home_rad)
    up = rough.upright_line(pose, 0.0, 0.05, down[-1])
    rough.hand.move(0.065, 0.1)
    rough.arm.execute(through(np.array([rough.home_rad, down[0]]), 1.5))
    rough.arm.execute(through(down, 1.0))
    rough.hand.grasp(30.0, 0.1)
    rough.hand.stop()
    rough.arm.execute(through(up, 1.0))
    rough.arm.execute(resting(up[-1], 1.0))
    assert rough.height_m() - truth[2, 3] == pytest.approx(0.05, abs=5e-3)
    rough.hand.move(0.08, 0.1)
    rough.arm.execute(through(np.array([up[-1], rough.home_rad]), 1.5))


FOLDER_GRIPS = {
    "cubesmall": Grip((0, 0, 0), (0, 1, 0), 0.020, 0.060, 0.040, 0.084),
    "flashlight": Grip((0, 0, 0), (0, 1, 0), 0.110, 0.060, 0.026, 0.091),
    "waterbottle": Grip((0, 0, 0), (0, 1, 0), 0.100, 0.075, 0.060, 0.397),
}


@pytest.mark.parametrize("name", sorted(FOLDER_GRIPS))
def test_objects_of_a_folder_are_lifted_too(name: str, public_objects: Callable[..., Path]) -> None:
    cell = Cell(load_station(None, [f"sim.objects={public_objects(name)}"]))
    lift = cell.pick(name, FOLDER_GRIPS[name])
    assert lift.rise_after_hold_m == pytest.approx(0.15, abs=0.01)
    assert lift.load_n == pytest.approx(FOLDER_GRIPS[name].mass_kg * GRAVITY_M_S2, rel=0.1, abs=0.1)
