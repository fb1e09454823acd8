"""The arguments of ``pick`` as they are written in Python, and what they mean for a job of the cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pydantic import ValidationError

from bus.errors import ConfigError
from bus.first_mistake import first_mistake
from bus.messages import Place, Target
from bus.messages.job import place_at

ToPick = str | Sequence[float] | Target | None
"""The object in words, as ``"the largest red one"``; x, y, z [m] in ``base`` of a point on it; or a `Target`: by pixel,
box or point. None = the best grasp's."""
ToLay = str | Sequence[float] | Place | None
"""The name of a place of the station; or x, y, z [m] in ``base``, perhaps with a heading [rad]. None = the tray."""


@contextmanager
def wrong_argument_named() -> Iterator[None]:
    """Context in which a job is made of a caller's arguments. Raises: ConfigError, which names the wrong one."""
    try:
        yield
    except ValidationError as error:
        raise ConfigError(
            f"{first_mistake(error, whole='the job')}.", "Lengths are in metres, angles in radians: docs/api.md, pick."
        ) from error


def target_of(target: ToPick) -> Target | None:
    """Return the target that a caller names. Raises: ConfigError for what is none; pydantic's error."""
    if target is None or isinstance(target, Target):
        return target
    if isinstance(target, str):
        return Target(text=target)
    numbers = _numbers("target", target, "It is words, a Target, or x, y, z [m] in base: Target(point_m=...).")
    if len(numbers) != 3:
        advice = "They are x, y, z [m] in base. A pixel is Target(pixel=(u, v)), a box Target(box=...)."
        raise ConfigError(f"target has {len(numbers)} numbers.", advice)
    x, y, z = numbers
    return Target(point_m=(x, y, z))


def place_of(place: ToLay) -> Place | None:
    """Return the place that a caller names. Raises: ConfigError for a number too many or few; pydantic's error."""
    if place is None or isinstance(place, Place):
        return place
    if isinstance(place, str):
        return Place(name=place)
    numbers = _numbers("place", place, "It is a name, a Place, or x, y, z [m] in base.")
    if len(numbers) not in (3, 4):
        raise ConfigError(
            f"place has {len(numbers)} numbers.", "They are x, y, z [m] in base, and perhaps a heading [rad]."
        )
    return place_at(numbers)


def _numbers(name: str, given: Sequence[float], advice: str) -> list[float]:
    """Return the numbers of an argument. Raises: ConfigError with ``advice`` for anything else."""
    try:
        return [float(one) for one in given]
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} is {given!r}.", advice) from error
