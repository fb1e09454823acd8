"""A job: what to pick, where to lay it, and how. It is an input of a cycle, and travels with every command of picks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field, model_validator

from bus.frozen import Message

Metres = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]
Pixels = Annotated[float, Field(ge=0, le=100_000, allow_inf_nan=False)]
Point = tuple[Metres, Metres, Metres]
Box = tuple[Pixels, Pixels, Pixels, Pixels]


class Target(Message):
    """The object to pick, named in exactly one way.

    Attributes:
        text: in words, e.g. ``the largest red one``.
        pixel: (u, v) in the undistorted colour image from the capture pose.
        box: (u_min, v_min, u_max, v_max) there: what lies mostly inside.
        point_m: (x, y, z) in ``base`` on or above the object.
        picture_ns: the stamp [ns, UTC] of the picture in which ``pixel`` or ``box`` was pointed at: the cell refuses
            one that no longer counts. None = whatever picture the cell takes next.
    """

    text: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    pixel: tuple[Pixels, Pixels] | None = None
    box: Box | None = None
    point_m: Point | None = None
    picture_ns: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> Target:
        require_one_way(self.text, self.pixel, self.box, self.point_m)
        if self.picture_ns is not None and self.pixel is None and self.box is None:
            raise ValueError("picture_ns goes with pixel or box")
        return self


class Place(Message):
    """The place where the object is laid: a place of the station by its name, or a position.

    Attributes:
        name: of ``[[scene.places]]``.
        position_m: (x, y, z) of the tcp in ``base`` when it lets go; higher where the object hangs lower.
        yaw_rad: heading of the closing axis in ``base`` when it lets go; None = any.
    """

    name: Annotated[str, Field(min_length=1, max_length=100)] | None = None
    position_m: Point | None = None
    yaw_rad: Annotated[float, Field(ge=-7, le=7, allow_inf_nan=False)] | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> Place:
        if (self.name is None) is (self.position_m is None):
            raise ValueError("a place is given by name or by position_m: one of the two")
        if self.name is not None and self.yaw_rad is not None:
            raise ValueError("yaw_rad goes with position_m; a place by name has its own")
        return self


class GraspHints(Message):
    """Limits of how the object may be held.

    Attributes:
        max_force_n: largest grasping force; None = the station's.
        from_above: only grasps that come from above.
    """

    max_force_n: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] | None = None
    from_above: bool = False


class Job(Message):
    """The request behind a ``pick``, or behind every pick of a ``start``.

    Attributes:
        job_id: the client's own name for it, returned in state, result and recording. While a job waits or is under
            way, another of its name is refused (``JOB_KNOWN``).
        target: the object; None = the one with the best grasp. ``place``: None = the station's tray.
        deadline_s: time from its acceptance, after which no further motion of it begins; None = no limit.
        grasp: how the object may be held.
        clear_way: what lies on the target is picked first, in cycles of its own; otherwise the pick ends OBSTRUCTED.
        queue: while the cell works, the job waits for its turn; otherwise the command is refused.
    """

    job_id: Annotated[str, Field(max_length=100, pattern=r"^[\x20-\x7e]*$")] = ""
    target: Target | None = None
    place: Place | None = None
    deadline_s: Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)] | None = None
    grasp: GraspHints = GraspHints()
    clear_way: bool = False
    queue: bool = False


def job_of(
    target: Target | None = None,
    place: Place | None = None,
    *,
    job_id: str = "",
    deadline_s: float | None = None,
    max_force_n: float | None = None,
    from_above: bool = False,
    clear_way: bool = False,
    queue: bool = False,
) -> Job:
    """Return the job of options that are given one by one. Raises: pydantic.ValidationError, which names the option."""
    return Job(
        job_id=job_id,
        target=target,
        place=place,
        deadline_s=deadline_s,
        grasp=GraspHints(max_force_n=max_force_n, from_above=from_above),
        clear_way=clear_way,
        queue=queue,
    )


def place_at(numbers: Sequence[float]) -> Place:
    """Return the place of three numbers x, y, z [m] in ``base``, or of four: with a heading [rad]."""
    x, y, z, *yaw = numbers
    return Place(position_m=(x, y, z), yaw_rad=yaw[0] if yaw else None)


def require_one_way(*ways: object, or_none: bool = False) -> None:
    """Check that exactly one of the ways to name a target is used. Raises: ValueError."""
    used = sum(way is not None for way in ways)
    if used > 1 or (used == 0 and not or_none):
        raise ValueError("a target is named by text, pixel, box or point_m: by one of them")
