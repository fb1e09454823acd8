"""What a caller of ``pick`` asks for, as a job of the cell."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import ValidationError

from bus.errors import ConfigError
from bus.messages import GraspHints, Job, Place, Target

ToPick = str | Target | None
"""The object in words, as ``"the largest red one"``; or a `Target`: by pixel, box or point. None = the best grasp's."""
ToLay = str | Sequence[float] | Place | None
"""The name of a place of the station; or x, y, z [m] in ``base``, perhaps with a heading [rad]. None = the tray."""


def job_of(
    target: ToPick,
    place: ToLay,
    job_id: str,
    deadline_s: float | None,
    max_force_n: float | None,
    from_above: bool,
    clear_way: bool,
    queue: bool,
) -> Job:
    """The job. Raises: ConfigError, which names the argument."""
    try:
        return Job(
            job_id=job_id,
            target=Target(text=target) if isinstance(target, str) else target,
            place=_place(place),
            deadline_s=deadline_s,
            grasp=GraspHints(max_force_n=max_force_n, from_above=from_above),
            clear_way=clear_way,
            queue=queue,
        )
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the job"
        raise ConfigError(
            f"{where}: {first['msg'].removeprefix('Value error, ')}.", "See docs/api.md, pick."
        ) from error


def _place(place: ToLay) -> Place | None:
    if place is None or isinstance(place, Place):
        return place
    if isinstance(place, str):
        return Place(name=place)
    try:
        numbers = [float(one) for one in place]
    except (TypeError, ValueError) as error:
        raise ConfigError(f"place is {place!r}.", "It is a name, a Place, or x, y, z [m] in base.") from error
    if len(numbers) not in (3, 4):
        raise ConfigError(
            f"place has {len(numbers)} numbers.", "They are x, y, z [m] in base, and perhaps a heading [rad]."
        )
    x, y, z, *yaw = numbers
    return Place(position_m=(x, y, z), yaw_rad=yaw[0] if yaw else None)
