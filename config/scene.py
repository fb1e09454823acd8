"""The fixed boxes around the arm from the station's settings: obstacles of the planner, geometry of the simulation."""

from __future__ import annotations

from config.schema import Box, SceneSettings, walls_on

TRAY_WALL_M = 0.010
"""Thickness of the tray's walls, centred on the tray's outline."""


def scene_boxes(scene: SceneSettings) -> tuple[Box, ...]:
    """Return every fixed box in ``base``: table, tray floor, tray walls, bins' walls, obstacles."""
    walls = tuple(wall for one in scene.bins for wall in one.walls)
    return (scene.table, scene.tray, *_tray_walls(scene), *walls, *scene.obstacles)


def floor_m(scene: SceneSettings, x_m: float, y_m: float) -> float | None:
    """Return the height in ``base`` of the highest box below a place; None where there is none."""
    tops = [
        box.center_m[2] + box.size_m[2] / 2
        for box in scene_boxes(scene)
        if abs(x_m - box.center_m[0]) <= box.size_m[0] / 2 and abs(y_m - box.center_m[1]) <= box.size_m[1] / 2
    ]
    return max(tops, default=None)


def _tray_walls(scene: SceneSettings) -> tuple[Box, ...]:
    """Return the four walls on the tray's rim; none where their height is 0."""
    if scene.tray_wall_height_m == 0:
        return ()
    (x, y, z), (length, width, thickness) = scene.tray.center_m, scene.tray.size_m
    return walls_on(scene.tray.name, (x, y, z + thickness / 2), (length, width), TRAY_WALL_M, scene.tray_wall_height_m)
