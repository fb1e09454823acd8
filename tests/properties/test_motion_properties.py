"""What must hold for every pick and every stop, judged by an oracle of its own.

The oracle below repeats the FR3's published limits (libfranka `rate_limiting.h` and Franka's control-parameter table)
and libfranka's backward differences; it shares no code with `config.limits`.
"""

from __future__ import annotations

import functools

import coal
import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Grasp, PickPlan
from bus.trajectory import Trajectory
from config.devices import NodeSettings
from config.limits import FR3
from config.scene import Box, SceneSettings
from config.schema import Station
from drivers.motion.stream import Stream
from planning.kinematics import inverse, q7_grid
from planning.pick import plan_pick
from planning.robot import Robot
from planning.scene import Scene

STATION = Station(nodes={"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))})
CAPTURE = np.array(STATION.arm.capture_q_rad)
X_MIN, X_MAX, Y_MIN, Y_MAX = STATION.scene.pick_region_m

RANGE = [(-2.7437, 2.7437), (-1.7837, 1.7837), (-2.9007, 2.9007), (-3.0421, -0.1518), (-2.8065, 2.8065),
         (0.5445, 4.5169), (-3.0159, 3.0159)]  # fmt: skip
OFF_PATH_RAD = 1e-5
CAP = [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26]
SPEED_SETS = [  # (offset, 2 x deceleration, lower reference, upper reference) of each joint
    [(0.30, 12.0, -2.7501, 2.7501), (0.20, 5.17, -1.7918, 1.7918), (0.20, 7.0, -2.9065, 2.9065),
     (0.30, 8.0, -3.0481, -0.1458), (0.35, 34.0, -2.8101, 2.8101), (0.35, 11.0, 0.5409, 4.5205),
     (0.35, 34.0, -3.0196, 3.0196)],
    [(0.6599, 12.0, -2.9007, 2.9007), (0.2517, 5.17, -1.8361, 1.8361), (0.2, 7.0, -2.9007, 2.9007),
     (0.3533, 8.0, -3.0770, -0.1169), (0.5757, 34.0, -2.8763, 2.8763), (0.4878, 11.0, 0.4398, 4.6216),
     (0.4628, 34.0, -3.0508, 3.0508)],
]  # fmt: skip


def violation(commands: np.ndarray) -> str | None:
    """The first published limit that 1 kHz ``commands`` (n, 7) break, from rest to rest; None if they keep all."""
    for joint, q in enumerate(commands.T):
        q = np.concatenate([[q[0]] * 3, q, [q[-1]] * 3])
        v = (q[1:] - q[:-1]) * 1e3
        a = (v[1:] - v[:-1]) * 1e3
        j = (a[1:] - a[:-1]) * 1e3
        fastest, slowest = np.full(len(v), CAP[joint]), np.full(len(v), -CAP[joint])
        for offset, braking, low, high in (s[joint] for s in SPEED_SETS):
            fastest = np.minimum(fastest, -offset + np.sqrt(np.maximum(0, braking * (high - q[1:]))))
            slowest = np.maximum(slowest, offset - np.sqrt(np.maximum(0, braking * (q[1:] - low))))
        if q.min() < RANGE[joint][0] or q.max() > RANGE[joint][1]:
            return f"position of joint {joint + 1}"
        if (v > np.maximum(fastest, 0)).any() or (v < np.minimum(slowest, 0)).any():
            return f"velocity of joint {joint + 1}"
        if np.abs(a).max() > 10.0:
            return f"acceleration of joint {joint + 1}"
        if np.abs(j).max() > 5000.0:
            return f"jerk of joint {joint + 1}"
    return None


@functools.cache
def robot() -> Robot:
    return Robot(STATION)


@functools.cache
def plan(x: float, y: float, z: float, yaw: float) -> PickPlan:
    return plan_pick(Scene.of(robot(), STATION), [grasp_at(x, y, z, yaw)], CAPTURE)


def grasp_at(x: float, y: float, z: float, yaw: float) -> Grasp:
    """A grasp from above."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], (x, y, z)
    return Grasp(base_from_tcp=pose, width_m=0.04, opening_m=0.07, score=1.0, rectangle=0,
                 imagined_base_from_tcp=pose, terms={})  # fmt: skip


picks = st.builds(
    plan,
    st.floats(X_MIN, X_MAX),
    st.floats(Y_MIN, Y_MAX),
    st.floats(0.01, 0.15),
    st.floats(-np.pi, np.pi),
)


def play(trajectory: Trajectory, asked: dict[int, str]) -> np.ndarray:
    """All commands; right before command number ``n`` the stream is asked to ``asked[n]``."""
    stream, asked = Stream(trajectory, FR3), dict(asked)
    commands: list[np.ndarray] = []
    while not (stream.held and not asked):
        if len(commands) in asked:
            getattr(stream, asked.pop(len(commands)))()
        command = stream.next()
        if command is None:
            break
        commands.append(command)
    return np.array(commands)


def distance_to_path(points: np.ndarray, path: np.ndarray) -> float:
    """Largest distance, in the worst joint, of any of ``points`` (n, 7) from the polyline ``path`` (m, 7)."""
    worst = 0.0
    for point in points:
        nearest = int(np.argmin(np.abs(path - point).max(axis=1)))
        a, b = path[max(0, nearest - 1) : nearest + 1][0], path[nearest : nearest + 2][-1]
        along = np.clip((point - a) @ (b - a) / max((b - a) @ (b - a), 1e-30), 0.0, 1.0)
        worst = max(worst, float(np.abs(point - a - along * (b - a)).max()))
    return worst


@settings(derandomize=True, max_examples=12, deadline=None)
@given(picks)
def test_every_motion_of_every_pick_keeps_every_published_limit(pick: PickPlan) -> None:
    for segment in pick.segments:
        assert violation(segment.trajectory.filtered()) is None, segment.name


@settings(derandomize=True, max_examples=12, deadline=None)
@given(picks, st.integers(0, 3), st.floats(0.0, 1.0))
def test_a_stop_at_any_instant_keeps_every_limit_and_stays_on_the_path(pick: PickPlan, index: int, when: float) -> None:
    trajectory = pick.segments[index].trajectory
    planned = trajectory.filtered()
    commands = play(trajectory, {1 + int(when * (len(planned) - 2)): "brake"})
    assert violation(commands) is None
    assert distance_to_path(commands[::5], planned) < OFF_PATH_RAD
    assert np.abs(commands[-1] - commands[-2]).max() < 1e-6, "at rest"
    assert len(commands) <= len(planned) + 200


@settings(derandomize=True, max_examples=12, deadline=None)
@given(picks, st.integers(0, 3), st.lists(st.integers(1, 400), min_size=4, max_size=4))
def test_held_and_resumed_twice_a_motion_keeps_every_limit_and_ends_at_its_end(
    pick: PickPlan, index: int, pauses: list[int]
) -> None:
    trajectory = pick.segments[index].trajectory
    at = np.cumsum(pauses).tolist()
    commands = play(trajectory, dict(zip(at, ("hold", "resume") * 2, strict=True)))
    assert violation(commands) is None
    assert distance_to_path(commands[::5], trajectory.filtered()) < OFF_PATH_RAD
    assert np.array_equal(commands[-1], trajectory.filtered()[-1])


@settings(derandomize=True, max_examples=12, deadline=None)
@given(picks)
def test_the_fingers_never_touch_the_table(pick: PickPlan) -> None:
    """By the tcp's height alone, without the planner's geometry: the tips reach 9.5 mm beyond a tcp that looks down."""
    for segment in pick.segments:
        for q in segment.trajectory.filtered()[::20]:
            pose = robot().base_from_tcp(q)
            assert pose[2, 3] + 0.0095 * pose[2, 2] > 0.0015, segment.name


@settings(derandomize=True, max_examples=12, deadline=None)
@given(picks)
def test_the_held_object_stays_above_where_it_lay(pick: PickPlan) -> None:
    before = robot().base_from_tcp(pick.segments[0].trajectory.end_q_rad)[2, 3]
    for segment in pick.segments:
        if segment.name in ("carry", "place"):
            heights_m = [robot().base_from_tcp(q)[2, 3] for q in segment.trajectory.filtered()[::20]]
            assert min(heights_m) > before - 1e-3
            assert heights_m[-1] > before + 0.04


def crowd(seed: int) -> tuple[Box, ...]:
    """Five boxes 10 to 40 cm tall beside the pick region, the base and the tray."""
    rng = np.random.default_rng(seed)
    boxes: list[Box] = []
    while len(boxes) < 5:
        x, y, height = rng.uniform(0.2, 0.8), rng.uniform(-0.6, 0.7), rng.uniform(0.1, 0.4)
        beside_region = not (X_MIN - 0.12 < x < X_MAX + 0.12 and Y_MIN - 0.12 < y < Y_MAX + 0.12)
        if beside_region and np.hypot(x, y) > 0.3 and np.hypot(x - 0.40, y - 0.45) > 0.32:
            boxes.append(Box(name=f"box-{len(boxes)}", center_m=(x, y, height / 2), size_m=(0.08, 0.08, height)))
    return tuple(boxes)


def touches(boxes: tuple[Box, ...], trajectory: Trajectory, width_m: float) -> bool:
    """By exact meshes, true boxes and every pair, no broad phase, every 5 ms."""
    model = pin.GeometryModel()
    for part in robot().meshes:
        model.addGeometryObject(part)
    parts = model.ngeoms
    for box in boxes:
        pose = pin.SE3(np.eye(3), np.array(box.center_m))
        shape = model.addGeometryObject(pin.GeometryObject(box.name, 0, 0, pose, coal.Box(*box.size_m)))
        for part in range(parts):
            model.addCollisionPair(pin.CollisionPair(part, shape))
    data, geometry = robot().model.createData(), model.createData()
    return any(
        pin.computeCollisions(robot().model, data, model, geometry, np.array([*q, width_m / 2, width_m / 2]), True)
        for q in trajectory.filtered()[::5]
    )


@settings(derandomize=True, max_examples=15, deadline=None)
@given(
    st.integers(0, 10**6), st.floats(X_MIN, X_MAX), st.floats(Y_MIN, Y_MAX), st.floats(0.02, 0.1), st.floats(-3.1, 3.1)
)
def test_among_random_boxes_every_motion_keeps_the_limits_and_touches_nothing(
    seed: int, x: float, y: float, z: float, yaw: float
) -> None:
    boxes = crowd(seed)
    scene = Scene.of(robot(), STATION.model_copy(update={"scene": SceneSettings(obstacles=boxes)}))
    try:
        pick = plan_pick(scene, [grasp_at(x, y, z, yaw)], CAPTURE)
    except CycleFailure as failure:
        assert failure.failure in (Code.COLLISION, Code.UNREACHABLE)
        assert "ways to grasp" in failure.text
        return
    for segment in pick.segments:
        assert violation(segment.trajectory.filtered()) is None, segment.name
        assert not touches(boxes, segment.trajectory, 0.04 if segment.name in ("carry", "place") else 0.08)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7))
def test_inverse_kinematics_round_trip(shares: list[float]) -> None:
    low, high = np.array(RANGE).T
    pose = robot().base_from_flange(low + np.array(shares) * (high - low))
    for q in inverse(pose, q7_grid(9)):
        assert np.abs(robot().base_from_flange(q) - pose).max() < 1e-9
