"""Draws docs/pick.jpg, the README's picture, from a recording: ``uv run python -m docs.pick_picture FILE.mcap``.

The recording is of the first cycle of a simulated run: the last tile plays its motions again, beside the robot.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")  # headless; MuJoCo reads it when it is first imported
import mujoco

from bus.messages import Detections, PickPlan
from config.load import station_from
from docs.chart import Image
from docs.planning_pictures import motions, on_white
from docs.tiles import save, strip
from drivers.sim.arm import SimArm
from drivers.sim.hand import SimHand
from drivers.sim.world import World
from logs.mcap.reader import CycleRecord, read_cycle
from logs.report.evidence import choice
from logs.report.images import annotated
from perception.geometry.window import Window
from planning.robot import Robot

PICTURE = Path(__file__).with_name("pick.jpg")
HEIGHT_PX = 240


def main(recording: Path) -> None:
    record = read_cycle(recording)
    found, plan = record.stages["detect"].result, record.stages["plan"].result
    assert isinstance(found, Detections) and isinstance(plan, PickPlan)
    station = station_from(dict(record.station))
    window = Window.around(found.evidence.object_mask)
    tiles = {
        "what it sees": window.cut(found.evidence.color, 0),
        "what it imagines": window.cut(found.evidence.goal_image, 255),
        "where it grasps": window.cut(annotated(found, *choice(record, found)), 0),
        "how it moves": motions(plan, Robot(station), station),
        "what it holds": _lifted(record, plan, World(station)),
    }
    save(strip(tiles, HEIGHT_PX), PICTURE)


def _lifted(record: CycleRecord, plan: PickPlan, world: World) -> Image:
    """The hand from aside at the end of the carry, after the recorded motions in a world of the same seed."""
    assert record.result is not None and record.result.object is not None
    world.present(record.result.object, int(record.metadata["seed"]) * 100_003)
    arm, hand, settings = SimArm(world), SimHand(world), world.station.hand
    arm.connect()
    hand.connect()
    hand.move(settings.max_width_m, settings.max_speed_m_s)
    for segment in plan.segments[:2]:
        if not arm.execute(segment.trajectory.model_copy(update={"waits_at": None})).finished:
            raise SystemExit(f"The arm stopped in {segment.name!r}: was it the first cycle of its run?")
        if segment.name == "reach":
            hand.grasp(settings.grasp_force_n, settings.speed_m_s)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = Robot(world.station).base_from_tcp(world.arm()[0])[:3, 3]
    camera.distance, camera.azimuth, camera.elevation = 0.65, 215, -14
    with mujoco.Renderer(world.model, 480, 480) as renderer:
        renderer.update_scene(world.data, camera)
        return on_white(renderer)


if __name__ == "__main__":
    main(Path(sys.argv[-1]))  # of several the last
