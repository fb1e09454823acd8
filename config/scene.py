"""The fixed surroundings of the arm: obstacles of the planner, geometry of the simulation."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from config.base import (
    Chunk,
    Metres,
    Settings,
    Size,
    SizeOrNone,
    Vector,
    wrong,
)
from config.place import NamedPlace


class Box(Settings):
    """A fixed, axis-aligned box of the scene in ``base``.

    Attributes:
        name: messages and reports name it so.
        center_m: its middle. ``size_m``: its edges along x, y and z.
    """

    name: Chunk
    center_m: Vector
    size_m: tuple[Size, Size, Size]


class Table(Box):
    """The table; its top is where objects lie.

    Attributes:
        tolerance_mm, tolerance_deg: the largest height above or below it, and the largest tilt, at which the camera may
            see it. Grasps follow the seen table; beyond this the cycle ends with TABLE_MOVED.
    """

    name: Chunk = "table"
    center_m: Vector = (0.45, 0.0, -0.02)
    size_m: tuple[Size, Size, Size] = (0.9, 1.4, 0.04)
    tolerance_mm: Annotated[float, Field(ge=0.1, le=200)] = 15.0
    tolerance_deg: Annotated[float, Field(gt=0, le=12)] = 5.0

    @property
    def top_m(self) -> float:
        """Height of its top in ``base``."""
        return self.center_m[2] + self.size_m[2] / 2


class Tray(Box):
    """The tray, into which what is picked is laid."""

    name: Chunk = "tray"
    center_m: Vector = (0.40, 0.45, 0.01)
    size_m: tuple[Size, Size, Size] = (0.30, 0.22, 0.02)


class Bin(Settings):
    """Four walls on the table, axis-aligned in ``base``; the table is the floor.

    Attributes:
        name: messages and reports name it so.
        center_m: (x, y) of its middle. ``size_m``: of its inside, along x and y.
        wall_height_m: of its walls above the table. ``wall_thickness_m``: outwards.
    """

    name: Chunk
    center_m: tuple[Metres, Metres]
    size_m: tuple[Size, Size]
    wall_height_m: Size = 0.08
    wall_thickness_m: Size = 0.01

    @property
    def walls(self) -> tuple[Box, ...]:
        """Front (towards the base), back, right and left: ``<name>-front`` and so on."""
        thickness_m = self.wall_thickness_m
        outline_m = (self.size_m[0] + thickness_m, self.size_m[1] + thickness_m)
        return walls_on(self.name, (*self.center_m, 0.0), outline_m, thickness_m, self.wall_height_m)


def walls_on(
    name: str, foot_m: Vector, outline_m: tuple[float, float], thickness_m: float, height_m: float
) -> tuple[Box, ...]:
    """Return four walls centred on a rectangle's outline around ``foot_m``.

    Args:
        foot_m: (x, y, z) middle of the walls' feet.
        outline_m: (along x, along y).
    """
    (x, y, z), (length, width) = foot_m, outline_m
    middle = z + height_m / 2
    along_x, along_y = (length + thickness_m, thickness_m, height_m), (thickness_m, width + thickness_m, height_m)
    sides = (
        ("front", -length / 2, 0.0, along_y),
        ("back", length / 2, 0.0, along_y),
        ("right", 0.0, -width / 2, along_x),
        ("left", 0.0, width / 2, along_x),
    )
    return tuple(
        Box(name=f"{name}-{side}", center_m=(x + dx, y + dy, middle), size_m=size) for side, dx, dy, size in sides
    )


_LEAST_REGION_M = 0.02


class SceneSettings(Settings):
    """The fixed surroundings of the arm. The table's top is the plane z = 0 of ``base``.

    Attributes:
        tray_wall_height_m: of the walls on the tray's rim, above its floor; 0 = none.
        pick_region_m: (x_min, x_max, y_min, y_max) in ``base``: the region searched for objects.
        place_m: tcp position at which the object is released, above the tray's floor.
        place_pattern_m: offsets from it along x and y of ``base``, one per cycle in turn, so that objects do not pile
            up; where that one is taken, the next that is free.
        place_higher_m: where all of them are taken, the object is let go up to so much higher, on what lies there;
            0 = never, as at the place of a job.
        place_yaw_rad: heading of the closing axis in ``base`` at the release; None = any.
        places: others by name, which a job may ask for.
        bins: bins with objects to pick; the pick region lies inside one, or outside all.
        max_height_m: what rises higher above the table is no object: the arm, a camera stand.
    """

    table: Table = Table()
    tray: Tray = Tray()
    tray_wall_height_m: SizeOrNone = 0.04
    pick_region_m: tuple[Metres, Metres, Metres, Metres] = (0.32, 0.60, -0.20, 0.20)
    place_m: Vector = (0.40, 0.45, 0.20)
    place_pattern_m: Annotated[tuple[tuple[Metres, Metres], ...], Field(min_length=1)] = ((0.0, 0.0),)
    place_higher_m: SizeOrNone = 0.0
    place_yaw_rad: Annotated[float, Field(ge=-7, le=7)] | None = None
    places: tuple[NamedPlace, ...] = ()
    obstacles: tuple[Box, ...] = ()
    bins: tuple[Bin, ...] = ()
    max_height_m: Size = 0.35

    @field_validator("pick_region_m")
    @classmethod
    def _region_is_one(cls, region_m: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        x_min, x_max, y_min, y_max = region_m
        if x_max - x_min < _LEAST_REGION_M or y_max - y_min < _LEAST_REGION_M:
            raise ValueError(f"x_min, x_max, y_min, y_max: from low to high, at least {_LEAST_REGION_M} m apart")
        return region_m

    @model_validator(mode="after")
    def _names_are_unique(self) -> SceneSettings:
        walls = [wall.name for one in self.bins for wall in one.walls]
        boxes = [box.name for box in (self.table, self.tray, *self.obstacles)]
        names = [*boxes, *(one.name for one in self.bins), *walls]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"every box and bin of the scene needs a name of its own; used twice: {', '.join(twice)}")
        places = [place.name for place in self.places]
        if len(set(places)) < len(places):
            raise ValueError(f"every place of the scene needs a name of its own: {', '.join(places)}")
        return self

    @model_validator(mode="after")
    def _pick_region_clear_of_walls(self) -> SceneSettings:
        x_min, x_max, y_min, y_max = self.pick_region_m
        for wall in (wall for one in self.bins for wall in one.walls):
            (x, y, _), (length, width, _) = wall.center_m, wall.size_m
            apart = x + length / 2 <= x_min or x_max <= x - length / 2
            apart = apart or y + width / 2 <= y_min or y_max <= y - width / 2
            if not apart:
                raise wrong("pick_region_m", f"reaches into the wall {wall.name!r}")
        return self


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
