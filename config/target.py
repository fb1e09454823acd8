"""Settings of what is picked: the target, and the station's own words for things."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from bus.messages.job import require_one_way
from config.base import Finite, Settings, Size, Vector

Color = Literal[
    "red", "orange", "yellow", "green", "cyan", "blue", "purple", "pink", "brown", "black", "grey", "white"
]  # fmt: skip


class TargetSettings(Settings):
    """The object to take when several stand in the pick region; at most one of them is set. A job names its own.

    Attributes:
        text: in words: a hosted model, or SAM 3 if it segments, locates it; without them the words of docs/use.md.
        pixel: (u, v) in the undistorted colour image. None of all = the one with the best grasp.
        box: (u_min, v_min, u_max, v_max) there.
        point_m: (x, y, z) in ``base``.
    """

    text: str | None = None
    pixel: tuple[Finite, Finite] | None = None
    box: tuple[Finite, Finite, Finite, Finite] | None = None
    point_m: Vector | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> TargetSettings:
        require_one_way(self.text, self.pixel, self.box, self.point_m, or_none=True)
        return self

    @property
    def is_named(self) -> bool:
        """Whether a certain object is asked for."""
        return any(way is not None for way in (self.text, self.pixel, self.box, self.point_m))


class Label(Settings):
    """A word of the station for a kind of thing, understood without a hosted model.

    Attributes:
        name: the word, in lower case, e.g. ``cup``.
        color: it has this colour. ``length_m``, ``height_m``: least and most of its longer side, and of its height.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z-]*$")]
    color: Color | None = None
    length_m: tuple[Size, Size] | None = None
    height_m: tuple[Size, Size] | None = None

    @model_validator(mode="after")
    def _says_something(self) -> Label:
        if self.color is None and self.length_m is None and self.height_m is None:
            raise ValueError(f"the label {self.name!r} needs a color, a length_m or a height_m")
        for low, high in filter(None, (self.length_m, self.height_m)):
            if low > high:
                raise ValueError(f"the label {self.name!r}: from the least to the most, not {low} to {high}")
        return self


def outside_picture(
    pixel: tuple[float, float] | None, box: tuple[float, float, float, float] | None, picture_px: tuple[int, int]
) -> str:
    """Say that a pixel, or the whole of a box, is outside a picture of so many pixels (width, height); "" = it is not.

    Args:
        pixel: (u, v). ``box``: (u_min, v_min, u_max, v_max).
    """
    width, height = picture_px
    u_min, v_min, u_max, v_max = box or (*(pixel or (0.0, 0.0)), *(pixel or (0.0, 0.0)))
    if u_max >= 0 and v_max >= 0 and u_min < width and v_min < height:
        return ""
    what = f"the box {box}" if box is not None else f"the pixel ({u_min:g}, {v_min:g})"
    return f"{what} is outside the picture, which has {width} x {height} pixels"
