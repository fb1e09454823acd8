"""Draws the figures of docs/planning.md from a recording: ``uv run python -m docs.planning_pictures FILE.mcap``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

os.environ.setdefault("MUJOCO_GL", "egl")  # headless; MuJoCo reads it when it is first imported
import mujoco

from bus.messages import Detections, PickPlan
from bus.trajectory import TICK_S, Trajectory
from config.limits import FR3, limit_shares
from config.load import station_from
from config.scene import Box
from config.schema import Station
from docs.chart import FAINT, Array, Chart, Image, Rgb, blank
from drivers.motion.stream import Stream
from drivers.sim.optics import FOVY_DEG, hand_from_cameras
from drivers.sim.robot import arm_joints
from drivers.sim.scene import compose
from logs.mcap.reader import CycleRecord, read_cycle
from logs.report.figures import JOINT_COLORS
from perception.scene.surroundings import surroundings
from planning.height_field import CELL_M, Sight
from planning.robot import Robot
from planning.scene import Scene

FOLDER = Path(__file__).parent / "planning"
SIZE_PX = (640, 480)
WIDE_PX = 900
_WHITE = (1.0, 1.0, 1.0)
_WHITE_SKY: dict[str, Any] = {
    "type": mujoco.mjtTexture.mjTEXTURE_SKYBOX, "builtin": mujoco.mjtBuiltin.mjBUILTIN_FLAT,
    "rgb1": _WHITE, "rgb2": _WHITE, "width": 64, "height": 384,
}  # fmt: skip
_CELL_M = 5.0
"""Everything in the cell is nearer to the camera beside it."""
COLORS = {"reach": (47, 111, 222), "carry": (224, 99, 45), "place": (44, 156, 105), "home": (150, 150, 160)}
"""Segments that are planned only in case the place must be looked at are not drawn."""
BOX_RGB, TARGET_RGB = (93, 107, 122), (196, 61, 92)
UNDISTURBED_RGB, HELD_RGB = (224, 99, 45), (47, 111, 222)


def main(recording: Path) -> None:
    record = read_cycle(recording)
    plan = record.stages["plan"].result
    assert isinstance(plan, PickPlan)
    station = station_from(dict(record.station))
    robot = Robot(station)
    FOLDER.mkdir(exist_ok=True)
    scene = np.hstack([motions(plan, robot, station), _field(record, robot, station)])
    cv2.imwrite(str(FOLDER / "scene.jpg"), scene[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    _limits(plan)
    _hold(plan)


def motions(plan: PickPlan, robot: Robot, station: Station) -> Image:
    """The cell from aside, with the way of the tcp through all four motions."""
    cell = compose(station, {}, hand_from_cameras(station), FOVY_DEG)
    cell.add_texture(**_WHITE_SKY)
    model = cell.compile()
    data = mujoco.MjData(model)
    before = plan.segments[0].trajectory.raw_q_rad
    for joint, q in zip(arm_joints(station), before[int(0.6 * len(before))], strict=True):
        data.joint(joint).qpos[:] = q
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = (0.35, 0.1, 0.2), 1.75, 140, -28
    with mujoco.Renderer(model, SIZE_PX[1], SIZE_PX[0]) as renderer:
        renderer.update_scene(data, camera)
        for segment in (segment for segment in plan.segments if segment.name in COLORS):
            _trace(renderer.scene, robot, segment.trajectory, COLORS[segment.name])
        image: Image = renderer.render()
        return image


def on_white(renderer: mujoco.Renderer) -> Image:
    """Return what the renderer sees, with white where nothing is."""
    image: Image = renderer.render()
    renderer.enable_depth_rendering()
    depth_m = renderer.render()
    renderer.disable_depth_rendering()
    return np.where(depth_m[..., None] < _CELL_M, image, np.uint8(255))


def _trace(scene: mujoco.MjvScene, robot: Robot, trajectory: Trajectory, rgb: Rgb) -> None:
    rgba = np.array([*(part / 255 for part in rgb), 1.0], dtype=np.float32)
    for q in trajectory.filtered()[::15]:
        geom = scene.geoms[scene.ngeom]
        position = robot.base_from_tcp(q)[:3, 3]
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, 0.006), position, np.eye(3).ravel(), rgba)
        scene.ngeom += 1


def _field(record: CycleRecord, robot: Robot, station: Station) -> Image:
    """Draw what planning takes for solid: the heights it saw besides the boxes it knows and the target."""
    found, observation = record.stages["detect"].result, record.observation
    assert isinstance(found, Detections) and observation is not None
    points, target = surroundings(observation, found.evidence.object_mask)
    scene = Scene.of(robot, station, Sight(points, target))
    image = blank(*SIZE_PX)
    chart = Chart(image, (50, 120, 550, 375), x=(0.70, -0.32), y=(0.20, 0.72))
    if scene.field is not None:
        (x, y), (rows, columns) = scene.field.origin_m, scene.field.height_m.shape
        colors = _colored(scene.field.height_m, float(scene.field.height_m.max()))
        chart.cells(colors, (y, y + rows * CELL_M), (x, x + columns * CELL_M))
        _height_bar(image, float(scene.field.height_m.max()))
    for box in scene.boxes[1:]:
        _outline(chart, box)
    if scene.target is not None:
        chart.points(scene.target[:, 1], scene.target[:, 0], TARGET_RGB)
        chart.legend({"the target": TARGET_RGB}, (300, 112))
    chart.axes("y of base [m]", "x of base [m]")
    return image


def _outline(chart: Chart, box: Box) -> None:
    (x, y, _), (length, width, _) = box.center_m, box.size_m
    around = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1], [-1, -1]]) / 2
    chart.curve(y + around[:, 1] * width, x + around[:, 0] * length, BOX_RGB)


def _colored(height_m: Array, highest_m: float) -> Image:
    """(n, m) heights in colour, white where nothing is."""
    shades = np.clip(height_m / highest_m * 255, 0, 255).astype(np.uint8)
    colors = cv2.applyColorMap(shades, cv2.COLORMAP_VIRIDIS)[..., ::-1]
    return np.where((height_m > 0)[..., None], colors, 255).astype(np.uint8)


def _height_bar(image: Image, highest_m: float) -> None:
    heights_m = np.linspace(highest_m / 256, highest_m, 256)[None]
    bar = Chart(image, (580, 120, 596, 375), x=(0.0, 1.0), y=(0.0, highest_m * 1e3))
    bar.cells(_colored(heights_m, highest_m), (0.0, 1.0), (0.0, highest_m * 1e3))
    bar.axes("", "solid up to [mm]", y_right=True)


def _limits(plan: PickPlan) -> None:
    """Velocity and acceleration of the reach, as shares of what is allowed where the arm is."""
    used = limit_shares(plan.segments[0].trajectory.filtered()).of_samples()
    t = np.arange(len(used.velocity)) * TICK_S
    image, colors = blank(WIDE_PX, 460), {f"joint {n + 1}": _rgb(color) for n, color in enumerate(JOINT_COLORS)}
    for top_px, name, x_name, times_s, values in (
        (45, "velocity / limit here", "", t, used.velocity),
        (245, "acceleration / limit", "time [s]", t, used.acceleration),
    ):
        chart = Chart(image, (50, top_px, WIDE_PX - 15, top_px + 170), x=(0.0, float(t[-1])), y=(-1.1, 1.1))
        for limit in (-1.0, 1.0):
            chart.curve(np.array([0.0, t[-1]]), limit, FAINT)
        for joint, rgb in enumerate(colors.values()):
            chart.curve(times_s, values[:, joint], rgb)
        chart.axes(x_name, name)
        if not x_name:
            chart.legend(colors, (260, top_px - 8))
    cv2.imwrite(str(FOLDER / "limits.png"), image[..., ::-1])


def _rgb(color: str) -> Rgb:
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def _hold(plan: PickPlan) -> None:
    """A hold in the middle of the carry, and its resume: the same path, later."""
    trajectory = max(plan.segments, key=lambda segment: segment.trajectory.duration_s).trajectory
    fastest = int(np.ptp(trajectory.raw_q_rad, axis=0).argmax())
    undisturbed, held = (np.diff(q[:, fastest]) / TICK_S for q in (trajectory.filtered(), _held(trajectory)))
    image, lowest, highest = blank(WIDE_PX, 280), min(undisturbed.min(), 0.0), max(undisturbed.max(), 0.0)
    room = 0.06 * (highest - lowest)
    chart = Chart(image, (50, 35, WIDE_PX - 15, 235), x=(0.0, len(held) * TICK_S), y=(lowest - room, highest + room))
    chart.dotted(np.arange(1, len(undisturbed) + 1) * TICK_S, undisturbed, UNDISTURBED_RGB)
    chart.curve(np.arange(1, len(held) + 1) * TICK_S, held, HELD_RGB)
    chart.axes("time [s]", f"joint {fastest + 1} [rad/s]")
    chart.legend({"undisturbed": UNDISTURBED_RGB, "held and resumed": HELD_RGB}, (620, 27))
    cv2.imwrite(str(FOLDER / "hold.png"), image[..., ::-1])


def _held(trajectory: Trajectory) -> Array:
    """The commands (n, 7) of a stream that is held at 40 % of the way and resumed 0.7 s later."""
    stream = Stream(trajectory, FR3)
    commands: list[Array] = []
    at = int(0.4 * len(trajectory.raw_q_rad))
    while True:
        if len(commands) == at:
            stream.hold()
        if len(commands) == at + 700:
            stream.resume()
        command = stream.next()
        if command is None:
            return np.array(commands)
        commands.append(command)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
