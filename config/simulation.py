"""The simulated cell."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from config.base import NonNegative, Settings, SystemPath, wrong


class SimSettings(Settings):
    """The simulated cell (MuJoCo).

    Attributes:
        pace: 0 = as fast as possible, in lockstep; 1 = real time.
        seed: of the objects, their poses and the cameras' noise: the same seed makes the same cycles.
        friction: sliding friction of the finger pads on objects.
        objects: folder of ``<name>/object.xml`` MJCF objects, and of meshes ``<name>.obj``, ``.stl`` or ``.ply`` in
            metres; None = the paper's five, built in.
        board: the calibration board lies on the table, and no object does.
        mounting_error_mm, mounting_error_deg: distance and angle of the true camera pose from the station's, in a
            seeded direction.
        clutter: 0 = every cycle brings one object; n = the pick region is filled once, with n.
        heaped: they are dropped, and lie on one another; otherwise they lie apart, of which far fewer fit.
    """

    pace: Annotated[float, Field(ge=0, le=10)] = 0.0
    friction: NonNegative = 0.8
    seed: int = 0
    objects: SystemPath | None = None
    clutter: Annotated[int, Field(ge=0, le=30)] = 0
    heaped: bool = False
    board: bool = False
    mounting_error_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    mounting_error_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    depth_noise: NonNegative = 1.0
    """Scale of the Femto Mega noise model; 0 = perfect depth."""

    @model_validator(mode="after")
    def _heaps_are_of_something(self) -> SimSettings:
        if self.heaped and self.clutter == 0:
            raise wrong("heaped", "says how the objects of clutter lie: set clutter to their number")
        return self
