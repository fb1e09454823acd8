"""What must hold for every pick and every stop, judged by an oracle of its own.

The oracle below repeats the FR3's published limits (libfranka `rate_limiting.h` and Franka's control-parameter table)
and libfranka's backward differences; it shares no code with `config.limits`.
"""

from __future__ import annotations

import functools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.messages import Grasp, PickPlan
from bus.trajectory import Trajectory
from config.schema import NodeSettings, Station
from drivers.stream import Stream
from planning.kinematics import inverse, q7_grid
from planning.pick import plan_pick
from planning.robot import Robot

STATION = Station(nodes={"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))})
CAPTURE = np.array(STATION.arm.capture_q_rad)
X_MIN, X_MAX, Y_MIN, Y_MAX = STATION.scene.pick_region_m

RANGE = [(-2.7437, 2.7437), (-1.7837, 1.7837), (-2.9007, 2.9007), (-3.0421, -0.1518), (-2.8065, 2.8065),
         (0.5445, 4.5169), (-3.0159, 3.0159)]  # fmt: skip
CORNER_RAD = 10.0 * (STATION.planning.window_ms * 1e-3) ** 2 / 24
"""A moving average leaves a bent path by at most a_max T^2 / 24, braked a little less than unbraked."""
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
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], (x, y, z)
    grasp = Grasp(base_from_tcp=pose, width_m=0.04, opening_m=0.07, score=1.0, rectangle=0,
                  imagined_base_from_tcp=pose, terms={})  # fmt: skip
    return plan_pick(robot(), STATION, [grasp], CAPTURE)


picks = st.builds(
    plan,
    st.floats(X_MIN, X_MAX),
    st.floats(Y_MIN, Y_MAX),
    st.floats(0.01, 0.15),
    st.floats(-np.pi, np.pi),
)


def play(trajectory: Trajectory, brake_at: int) -> np.ndarray:
    stream, commands = Stream(trajectory), []
    while True:
        if len(commands) == brake_at:
            stream.brake()
        command = stream.next()
        if command is None:
            return np.array(commands)
        commands.append(command)


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
@given(picks, st.integers(0, 7), st.floats(0.0, 1.0))
def test_a_stop_at_any_instant_keeps_every_limit_and_stays_on_the_path(pick: PickPlan, index: int, when: float) -> None:
    trajectory = pick.segments[index].trajectory
    planned = trajectory.filtered()
    commands = play(trajectory, int(when * len(planned)))
    assert violation(commands) is None
    assert distance_to_path(commands[::5], planned) < CORNER_RAD
    assert np.abs(commands[-1] - commands[-2]).max() < 1e-6, "at rest"
    assert len(commands) <= len(planned) + 200


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
    before = robot().base_from_tcp(pick.segments[1].trajectory.end_q_rad)[2, 3]
    for segment in pick.segments:
        if segment.name in ("view", "place"):
            heights_m = [robot().base_from_tcp(q)[2, 3] for q in segment.trajectory.filtered()[::20]]
            assert min(heights_m) > before + 0.04


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7))
def test_inverse_kinematics_round_trip(shares: list[float]) -> None:
    low, high = np.array(RANGE).T
    pose = robot().base_from_flange(low + np.array(shares) * (high - low))
    for q in inverse(pose, q7_grid(9)):
        assert np.abs(robot().base_from_flange(q) - pose).max() < 1e-9
