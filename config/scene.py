"""The fixed boxes around the arm from the station's settings: obstacles of the planner, geometry of the simulation."""

from __future__ import annotations

from config.schema import Box, SceneSettings, Station, walls_on

TRAY_WALL_M = 0.010
"""Thickness of the tray's walls, centred on the tray's outline."""


def scene_boxes(scene: SceneSettings) -> tuple[Box, ...]:
    """Return every fixed box in ``base``: table, tray floor, tray walls, bins' walls, obstacles."""
    walls = tuple(wall for one in scene.bins for wall in one.walls)
    return (scene.table, scene.tray, *_tray_walls(scene), *walls, *scene.obstacles)


def placing_at(station: Station, number: int) -> Station:
    """Return the station whose ``place_m`` is the ``number``-th of its place pattern; its own pattern is one zero."""
    scene = station.scene
    (dx, dy), (x, y, z) = scene.place_pattern_m[number % len(scene.place_pattern_m)], scene.place_m
    placed = scene.model_copy(update={"place_m": (x + dx, y + dy, z), "place_pattern_m": ((0.0, 0.0),)})
    return station.model_copy(update={"scene": placed})


def _tray_walls(scene: SceneSettings) -> tuple[Box, ...]:
    """Return the four walls on the tray's rim; none where their height is 0."""
    if scene.tray_wall_height_m == 0:
        return ()
    (x, y, z), (length, width, thickness) = scene.tray.center_m, scene.tray.size_m
    return walls_on(scene.tray.name, (x, y, z + thickness / 2), (length, width), TRAY_WALL_M, scene.tray_wall_height_m)
