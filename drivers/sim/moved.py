"""A simulated table, or a fixed box, that is not where the station says: errors for tests and benchmarks."""

from __future__ import annotations

import mujoco

from bus.arrays import Vector3
from drivers.sim.world import World


def raise_table(world: World, by_m: float) -> None:
    """Put the table's top ``by_m`` above where the station has it, with what lies on it; the station is not told."""
    table = world.station.scene.table
    with world.lock:
        geom = world.model.geom(table.name).id
        lifted_m = table.center_m[2] + by_m - float(world.model.geom_pos[geom, 2])
        world.model.geom_pos[geom, 2] += lifted_m
        for body in world.objects:
            world.data.joint(body).qpos[2] += lifted_m
        mujoco.mj_forward(world.model, world.data)


def move_box(world: World, name: str, center_m: Vector3) -> None:
    """Put a box of the scene elsewhere, ``center_m`` (3,) in ``base``; the station is not told."""
    with world.lock:
        world.model.geom_pos[world.model.geom(name).id] = center_m
        mujoco.mj_forward(world.model, world.data)
