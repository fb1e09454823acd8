"""A named place of the station, where a job may have its object laid."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from config.base import Chunk, Metres, Settings, Vector


class NamedPlace(Settings):
    """A place by name.

    Attributes:
        name: a job asks for it so.
        position_m: (x, y, z) of the tcp in ``base`` when it lets go; higher where the object hangs lower.
        yaw_rad: heading of the closing axis in ``base`` when it lets go; None = any.
        pattern_m: offsets along x and y of ``base``, used in turn, so that objects do not pile up; where one is taken,
            the next that is free.
        capacity: number of objects it takes, until the next ``reset`` by a client; 0 = any number.
    """

    name: Chunk
    position_m: Vector
    yaw_rad: Annotated[float, Field(ge=-7, le=7)] | None = None
    pattern_m: Annotated[tuple[tuple[Metres, Metres], ...], Field(min_length=1)] = ((0.0, 0.0),)
    capacity: Annotated[int, Field(ge=0, le=1_000_000)] = 0
