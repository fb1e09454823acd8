"""The fixed boxes around the arm, from the station's settings: what the planner avoids and the simulation builds."""

from __future__ import annotations

from config.schema import Box, SceneSettings

TRAY_WALL_M = 0.010
"""Thickness of the tray's walls, centred on the tray's outline."""


def scene_boxes(scene: SceneSettings) -> tuple[Box, ...]:
    """Everything that stands still: table, tray floor, tray walls, obstacles. All in ``base``."""
    return (scene.table, scene.tray, *_tray_walls(scene), *scene.obstacles)


def _tray_walls(scene: SceneSettings) -> tuple[Box, ...]:
    """Four walls that stand on the tray's rim."""
    if scene.tray_wall_height_m == 0:
        return ()
    (x, y, z), (length, width, thickness) = scene.tray.center_m, scene.tray.size_m
    height = scene.tray_wall_height_m
    middle = z + thickness / 2 + height / 2
    along_x, along_y = (length + TRAY_WALL_M, TRAY_WALL_M, height), (TRAY_WALL_M, width + TRAY_WALL_M, height)
    sides = (
        ("front", -length / 2, 0.0, along_y),
        ("back", length / 2, 0.0, along_y),
        ("right", 0.0, -width / 2, along_x),
        ("left", 0.0, width / 2, along_x),
    )
    return tuple(
        Box(name=f"{scene.tray.name}-{side}", center_m=(x + dx, y + dy, middle), size_m=size)
        for side, dx, dy, size in sides
    )
