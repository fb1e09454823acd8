"""Draws the figures of docs/planning.md from a recorded cycle: ``planning_pictures.py FILE.mcap``."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import matplotlib
import mujoco
import numpy as np

from bus.messages import Detections, PickPlan
from bus.trajectory import TICK_S, Trajectory
from config.limits import ACCELERATION_RAD_S2, velocity_bounds
from config.load import station_from
from config.schema import Station
from drivers.motion.stream import Stream
from drivers.sim.optics import FOVY_DEG, hand_from_cameras
from drivers.sim.scene import ARM_JOINTS, compose
from logs.mcap.reader import CycleRecord, read_cycle
from perception.scene.surroundings import surroundings
from planning.height_field import CELL_M
from planning.robot import Robot
from planning.scene import Scene, Sight

matplotlib.use("agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).parent / "planning"
SIZE_PX = (640, 480)
COLORS = {"reach": (47, 111, 222), "carry": (224, 99, 45), "place": (44, 156, 105), "home": (150, 150, 160)}


def main(recording: Path) -> None:
    record = read_cycle(recording)
    plan = record.stages["plan"].result
    assert isinstance(plan, PickPlan)
    station = station_from(dict(record.station))
    robot = Robot(station)
    FOLDER.mkdir(exist_ok=True)
    scene = np.hstack([_motions(plan, robot, station), _field(record, robot, station)])
    cv2.imwrite(str(FOLDER / "scene.jpg"), scene[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    _limits(plan)
    _hold(plan)


def _motions(plan: PickPlan, robot: Robot, station: Station) -> np.ndarray:
    """The cell from aside, with the way of the tcp through all four motions."""
    model = compose(station, {}, hand_from_cameras(station), FOVY_DEG).compile()
    data = mujoco.MjData(model)
    before = plan.segments[0].trajectory.raw_q_rad
    for joint, q in zip(ARM_JOINTS, before[int(0.6 * len(before))], strict=True):
        data.joint(joint).qpos[:] = q
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = (0.35, 0.1, 0.2), 1.75, 140, -28
    with mujoco.Renderer(model, SIZE_PX[1], SIZE_PX[0]) as renderer:
        renderer.update_scene(data, camera)
        for segment in plan.segments:
            _trace(renderer.scene, robot, segment.trajectory, COLORS[segment.name])
        return renderer.render()


def _trace(scene: mujoco.MjvScene, robot: Robot, trajectory: Trajectory, rgb: tuple[int, int, int]) -> None:
    rgba = np.array([*(part / 255 for part in rgb), 1.0], dtype=np.float32)
    for q in trajectory.filtered()[::15]:
        geom = scene.geoms[scene.ngeom]
        position = robot.base_from_tcp(q)[:3, 3]
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, 0.006), position, np.eye(3).ravel(), rgba)
        scene.ngeom += 1


def _field(record: CycleRecord, robot: Robot, station: Station) -> np.ndarray:
    """What planning takes for solid: the heights it saw besides the boxes it knows and the target."""
    found, observation = record.stages["detect"].result, record.observation
    assert isinstance(found, Detections) and observation is not None
    points, target = surroundings(observation, found.evidence.object_mask)
    scene = Scene.of(robot, station, Sight(points, target))
    figure, axes = plt.subplots(figsize=(SIZE_PX[0] / 100, SIZE_PX[1] / 100), dpi=100)
    if scene.field is not None:
        heights = np.where(scene.field.height_m > 0, scene.field.height_m * 1e3, np.nan)
        (x, y), (rows, columns) = scene.field.origin_m, heights.shape
        extent = (y, y + rows * CELL_M, x, x + columns * CELL_M)
        shown = axes.imshow(heights.T, origin="lower", extent=extent, cmap="viridis")
        figure.colorbar(shown, label="seen, solid up to here [mm]", shrink=0.8)
    for box in scene.boxes[1:]:
        (cx, cy, _), (length, width, _) = box.center_m, box.size_m
        axes.add_patch(plt.Rectangle((cy - width / 2, cx - length / 2), width, length, fill=False, ec="#5d6b7a", lw=1))
    if scene.target is not None:
        axes.scatter(scene.target[:, 1], scene.target[:, 0], s=3, c="#c43d5c", label="the target")
        axes.legend(loc="lower left")
    axes.set(xlim=(0.70, -0.32), ylim=(0.2, 0.72), xlabel="y of base [m]", ylabel="x of base [m]", aspect="equal")
    figure.tight_layout()
    figure.canvas.draw()
    picture = np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()
    plt.close(figure)
    return picture


def _limits(plan: PickPlan) -> None:
    """Velocity and acceleration of the reach, as shares of what is allowed where the arm is."""
    q = plan.segments[0].trajectory.filtered()
    t = np.arange(1, len(q)) * TICK_S
    velocity = np.diff(q, axis=0) / TICK_S
    lower, upper = velocity_bounds(q[1:])
    share = velocity / np.where(velocity > 0, upper, -lower)
    acceleration = np.diff(velocity, axis=0) / TICK_S / ACCELERATION_RAD_S2
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 4.6), dpi=100, sharex=True)
    for joint in range(7):
        top.plot(t, share[:, joint], lw=1.2, label=f"joint {joint + 1}")
        bottom.plot(t[1:], acceleration[:, joint], lw=1.2)
    for axes, name in ((top, "velocity / limit here"), (bottom, "acceleration / limit")):
        axes.axhline(1, c="k", lw=0.6, ls=":")
        axes.axhline(-1, c="k", lw=0.6, ls=":")
        axes.set_ylabel(name)
    top.legend(ncol=7, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, 1.22), frameon=False)
    bottom.set_xlabel("time [s]")
    figure.tight_layout()
    figure.savefig(FOLDER / "limits.png")
    plt.close(figure)


def _hold(plan: PickPlan) -> None:
    """A hold in the middle of the carry, and its resume: the same path, later."""
    trajectory = max(plan.segments, key=lambda segment: segment.trajectory.duration_s).trajectory
    stream, commands = Stream(trajectory), []
    while True:
        if len(commands) == int(0.4 * len(trajectory.raw_q_rad)):
            stream.hold()
        if len(commands) == int(0.4 * len(trajectory.raw_q_rad)) + 700:
            stream.resume()
        command = stream.next()
        if command is None:
            break
        commands.append(command)
    figure, axes = plt.subplots(figsize=(9, 2.8), dpi=100)
    fastest = int(np.ptp(trajectory.raw_q_rad, axis=0).argmax())
    for q, style, name in ((trajectory.filtered(), ":", "undisturbed"), (np.array(commands), "-", "held and resumed")):
        axes.plot(np.arange(1, len(q)) * TICK_S, np.diff(q[:, fastest]) / TICK_S, style, label=name, c="#2f6fde")
    axes.set(xlabel="time [s]", ylabel=f"joint {fastest + 1} [rad/s]")
    axes.legend(frameon=False)
    figure.tight_layout()
    figure.savefig(FOLDER / "hold.png")
    plt.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
