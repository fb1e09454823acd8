"""Guarded approaches in simulation: a table higher than believed, a hidden post under the palm, and free descents.

The judge is the simulation's own contact force between the robot and what stands fixed, every millisecond, and how far
the finger tips went on after they first touched; neither is what the arm estimates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from bus.commands import PresentRequest
from bus.errors import ArmReflex
from bus.messages import Execution, Motion, Observation, Verdict
from bus.trajectory import Trajectory
from bus.transforms import from_rotation
from cell.machine.gate import Gate
from cell.pick.capture import capture
from cell.pick.detect import detect
from cell.pick.execute import execute
from cell.pick.plan import plan, scenes
from cell.pick.touching import Thing, guarded
from cell.pick.verify import verify
from config.franka_hand import FINGER_TIP_M, PALM_ABOVE_TIP_M
from config.load import load_station
from config.scene import Box
from config.schema import Station
from drivers.node.guard import Guard
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.devices import SimPresenter
from drivers.sim.hand import SimHand
from drivers.sim.moved import move_box, raise_table
from drivers.sim.world import World
from perception.models import open_models
from planning.blend import blended
from planning.candidates import configurations, twins
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot
from planning.scene import FINGER_CLEARANCE_M
from planning.slow_end import slow_end
from planning.timing import timed

TABLE_MM, SPEEDS, OBJECTS = (4.0, 6.0, 8.0, 10.0), (0.3, 0.6, 1.0), ("cup", "spatula", "bottle", "controller", "drone")
_POST = Box(name="post", center_m=(0.45, 0.0, -1.0), size_m=(0.02, 0.02, 0.20))
_POST_BESIDE_M = 0.07
"""From the tcp to the post along the closing axis: outside the opened fingers, under the palm."""
_TOUCHES_N = 0.05
_OPENING_M = 0.08
_HIGH_M, _BESIDE_MM = 0.06, 29.0
_NEAR_M = 0.01
_AWAY_M = (0.0, 0.9, -3.0)


@dataclass
class Felt:
    """The true force [N] and the height of the hand [m] in one motion, as the world judged them, a row each tick."""

    force_n: list[float] = field(default_factory=list)
    hand_m: list[float] = field(default_factory=list)

    @property
    def peak_n(self) -> float:
        """Largest force."""
        return max(self.force_n, default=0.0)

    @property
    def overshoot_mm(self) -> float:
        """The way of the hand further down after it first touched; 0 when it never did."""
        touched = np.flatnonzero(np.array(self.force_n) > _TOUCHES_N)
        return float(self.hand_m[touched[0]] - min(self.hand_m)) * 1e3 if len(touched) else 0.0


class JudgedWorld(World):
    """A world that judges the contact of the robot with fixed boxes in every tick."""

    felt = Felt()

    def tick(self) -> None:
        """Simulate one millisecond, and judge it."""
        super().tick()
        with self.lock:
            self.felt.force_n.append(self._force_n())
            self.felt.hand_m.append(float(self.data.body("hand").xpos[2]))

    def _force_n(self) -> float:
        """Vertical force between the robot and whatever is fixed."""
        total, wrench = 0.0, np.zeros(6)
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            bodies = self.model.geom_bodyid[[contact.geom1, contact.geom2]]
            if self._is_robot[bodies].any() and (self.model.body_weldid[bodies] == 0).any():
                mujoco.mj_contactForce(self.model, self.data, index, wrench)
                total += abs(float((contact.frame.reshape(3, 3).T @ wrench[:3])[2]))
        return total


class Bench:
    """An arm over an empty table: straight descents that should end just above it."""

    def __init__(self, settings: Sequence[str] = ()) -> None:
        self.station = with_post(load_station(None, list(settings)))
        self.robot, self.world = Robot(self.station), JudgedWorld(self.station)
        self.arm = SimArm(self.world)
        self.arm.connect()
        self.world.data.joint("object").qpos[:3] = _AWAY_M

    def descent(
        self,
        x_m: float,
        y_m: float,
        yaw_rad: float,
        speed: float = 1.0,
        above_m: float = 0.0,
        *,
        is_beside: bool = False,
    ) -> Trajectory:
        """Return a reach, as the cell would play it, from the capture pose to a top-down grasp.

        Args:
            above_m: height of its end above the lowest grasp there is; so high nothing is near the hand.
            is_beside: the hand is believed to pass things all the way.
        """
        station, q_rad = self.station, np.array(self.station.arm.capture_q_rad)
        lowest_m = station.scene.table.top_m + FINGER_CLEARANCE_M + 5e-4 + FINGER_TIP_M
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        down = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
        way_m = np.array([0.0, 0.0, -station.planning.approach_m])
        pose = from_rotation(down, np.array([x_m, y_m, lowest_m + above_m]) - way_m)
        for before, exact in configurations(FR3_ARM, twins(pose), q_rad):
            line = tcp_line(FR3_ARM, before, exact, way_m)
            if line is not None:
                slower = station.model_copy(update={"arm": station.arm.model_copy(update={"speed": speed})})
                felt = slow_end(
                    self.robot, line, station.execute, lambda _: above_m < _NEAR_M, lambda _: is_beside
                )  # fmt: skip
                reach = timed(slower, blended([np.stack([q_rad, before]), line]), slow_end=felt)
                return guarded(self.robot, station, reach).model_copy(update={"waits_at": None})
        raise ValueError(f"no way down to {x_m:.3f}, {y_m:.3f} m")

    def play(self, reach: Trajectory) -> tuple[Motion | None, Felt]:
        """Play it from its start; returns the motion, None after a reflex, and what was felt."""
        self.world.pose_robot(reach.start_q_rad, _OPENING_M)
        self.world.command_arm(reach.start_q_rad, reach.start_q_rad)
        felt = self.world.felt = Felt()
        try:
            return self.arm.execute(reach), felt
        except ArmReflex:
            self.arm.recover()
            return None, felt


def with_post(station: Station) -> Station:
    """Return the station with a post that stands out of the way, deep below the table."""
    return station.model_copy(update={"scene": station.scene.model_copy(update={"obstacles": (_POST,)})})


@dataclass(frozen=True)
class Pick:
    """One whole pick, with the world changed after it was planned."""

    execution: Execution
    verdict: Verdict
    felt: Felt
    rose_m: float


def pick(name: str, change: Callable[[World, Robot, Trajectory], None], settings: Sequence[str] = ()) -> Pick:
    """Look at an object, plan, let ``change`` do to the world what the cell does not know, and execute."""
    station = with_post(load_station(None, ["sim.seed=3", "verify.hold_s=0.5", *settings]))
    world, robot = JudgedWorld(station), Robot(station)
    camera, arm, hand, table = SimCamera(world), Guard(SimArm(world), station), SimHand(world), SimPresenter(world)
    for device in (camera, arm, hand):
        device.connect()
    hand.home()
    table.present(PresentRequest(object=name, cycle=0, seed=3))

    def look() -> Observation:
        return capture(camera, arm, robot)

    before = look()
    found = detect([before], station, open_models(station, {}))
    chosen = plan(found, [before], robot, station)
    grasp = found.grasps[chosen.grasp]
    change(world, robot, chosen.segments[0].trajectory)
    lay_m, felt = table.truth().base_from_object[2, 3], Felt()
    world.felt = felt
    (top_m,) = (float(one.top_m[2]) for one in found.scene.instances if one.number == grasp.instance)
    thing = Thing(top_m, lambda: scenes(found, [before], robot, station)(grasp))
    execution, after = execute(chosen, grasp, (arm, hand), look, robot, station, Gate(), thing)
    rose_m = float(table.truth().base_from_object[2, 3] - lay_m)
    verdict = verify(execution, found, grasp, before, after, robot, station)
    camera.close()
    return Pick(execution, verdict, felt, rose_m)


def table_higher(by_mm: float) -> Callable[[World, Robot, Trajectory], None]:
    """A change: the table and what lies on it are higher."""
    return lambda world, _robot, _reach: raise_table(world, by_mm / 1e3)


def post_under_palm(by_mm: float) -> Callable[[World, Robot, Trajectory], None]:
    """A change: a post beside the object reaches ``by_mm`` higher than where the palm ends."""

    def change(world: World, robot: Robot, reach: Trajectory) -> None:
        place_post(world, robot, reach, by_mm)

    return change


def place_post(world: World, robot: Robot, reach: Trajectory, by_mm: float) -> None:
    """Put the post under the palm so that it touches ``by_mm`` before the end of ``reach``, a top-down one."""
    pose = robot.base_from_tcp(reach.end_q_rad)
    center_m = pose[:3, 3] + _POST_BESIDE_M * pose[:3, 1]
    center_m[2] += PALM_ABOVE_TIP_M - FINGER_TIP_M + by_mm / 1e3 - _POST.size_m[2] / 2
    move_box(world, _POST.name, center_m)


@dataclass
class Tally:
    """The results of the descents.

    Attributes:
        force_n: largest true forces: onto a raised table; onto a hidden post near the end of the approach; onto one
            29 mm before it, beside things that were seen.
    """

    force_n: dict[str, list[float]] = field(default_factory=lambda: {"table": [], "post": [], "beside": []})
    overshoot_mm: list[float] = field(default_factory=list)
    reflexes: int = 0
    beside_reflexes: int = 0
    unnoticed: int = 0


def run(tries: int, free: int, seed: int, tell: Callable[[str], None], settings: Sequence[str] = ()) -> dict[str, Any]:
    """Return the figures of ``tries`` descents that meet something, ``free`` that do not, and a pick of each object."""
    bench, rng, tally = Bench(settings), np.random.default_rng(seed), Tally()
    for index in range(tries):
        tell(f"{index + 1}/{tries} {_meet(bench, rng, index, tally)}")
    for _ in range(tries // 5):
        tell(_meet_beside(bench, rng, tally))
    false_contacts = _false_contacts(bench, rng, free)
    tell(f"{free} free descents, {false_contacts} false contacts")
    picks = [pick(name, table_higher(10.0), settings) for name in OBJECTS]
    tell("; ".join(f"{name}: {one.verdict.reason}" for name, one in zip(OBJECTS, picks, strict=True)))
    return {
        "contact": {
            "tries": tries,
            "force_n": _spread(tally.force_n["table"]),
            "hidden_force_n": _spread(tally.force_n["post"]),
            "overshoot_mm": _spread(tally.overshoot_mm),
            "reflexes": tally.reflexes,
            "beside_force_n": _spread(tally.force_n["beside"]),
            "beside_reflexes": tally.beside_reflexes,
            "unnoticed": tally.unnoticed,
            "picks": len(picks),
            "held": sum(one.verdict.held and one.rose_m > 0.05 for one in picks),
            "picks_with_contact": sum(one.execution.contact is not None for one in picks),
            "free": free,
            "false_contacts": false_contacts,
        }
    }


def _meet(bench: Bench, rng: np.random.Generator, index: int, tally: Tally) -> str:
    """Play one descent that meets the table or, each fifth, a post; returns what came of it, in words."""
    by_mm, is_post = TABLE_MM[index % len(TABLE_MM)], index % 5 == 4
    above_m = _HIGH_M if is_post else 0.0
    reach = bench.descent(*_place(rng), speed=SPEEDS[index % len(SPEEDS)], above_m=above_m)
    raise_table(bench.world, 0.0 if is_post else by_mm / 1e3)
    place_post(bench.world, bench.robot, reach, by_mm - 2.0 if is_post else -100.0)
    motion, felt = bench.play(reach)
    what = "post" if is_post else "table"
    tally.force_n[what].append(felt.peak_n)
    tally.overshoot_mm.append(felt.overshoot_mm)
    tally.reflexes += motion is None
    tally.unnoticed += motion is not None and motion.contact_n is None
    return f"{what} {by_mm:.0f} mm: {felt.peak_n:.1f} N, {felt.overshoot_mm:.2f} mm"


def _meet_beside(bench: Bench, rng: np.random.Generator, tally: Tally) -> str:
    """Play one descent that meets a post far above its end, beside things that were seen; as `_meet`."""
    reach = bench.descent(*_place(rng), above_m=_HIGH_M, is_beside=True)
    raise_table(bench.world, 0.0)
    place_post(bench.world, bench.robot, reach, _BESIDE_MM)
    motion, felt = bench.play(reach)
    tally.force_n["beside"].append(felt.peak_n)
    tally.beside_reflexes += motion is None
    return f"post {_BESIDE_MM:.0f} mm before the end: {felt.peak_n:.1f} N"


def _false_contacts(bench: Bench, rng: np.random.Generator, free: int) -> int:
    """Play ``free`` descents that meet nothing; returns how many were stopped all the same."""
    raise_table(bench.world, 0.0)
    move_box(bench.world, _POST.name, np.array(_POST.center_m))
    motions = [bench.play(bench.descent(*_place(rng), speed=SPEEDS[index % len(SPEEDS)]))[0] for index in range(free)]
    return sum(motion is None or motion.contact_n is not None for motion in motions)


def _place(rng: np.random.Generator) -> tuple[float, float, float]:
    return float(rng.uniform(0.34, 0.58)), float(rng.uniform(-0.18, 0.18)), float(rng.uniform(-1.5, 1.5))


def _spread(values: Sequence[float]) -> dict[str, float]:
    p50, p99, most = np.percentile(values or [0.0], [50, 99, 100]).round(2).tolist()
    return {"p50": p50, "p99": p99, "max": most}
