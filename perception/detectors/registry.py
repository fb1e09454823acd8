"""Name -> the detector that finds the grasps.

Ours is ``vlad`` (`perception.detector`). Another package brings one as an entry point of the group
``vlad_cell.detectors``: a class or function that is given the station and its checked settings.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from pydantic import BaseModel, ValidationError

from bus.errors import ConfigError
from bus.redaction import quoted
from config.base import Settings
from config.schema import Station
from perception.detectors.base import GraspDetector

GROUP = "vlad_cell.detectors"
OURS = "vlad"


class NoSettings(Settings):
    """Of a detector without settings of its own."""


def points() -> tuple[EntryPoint, ...]:
    """The entry points of other packages, sorted by name; none can take over the name of ours."""
    return tuple(sorted((one for one in entry_points(group=GROUP) if one.name != OURS), key=lambda one: one.name))


def names() -> tuple[str, ...]:
    """Every detector that a station can name, ours first."""
    return (OURS, *dict.fromkeys(point.name for point in points()))


def open_detector(station: Station) -> GraspDetector | None:
    """The detector that the station names; None = ours.

    Raises: ConfigError for an unknown name, for a package that cannot be imported, and for a setting, which it names.
    """
    name = station.perception.detector
    if name not in names():
        raise ConfigError(f"Unknown detector {name!r}.", f"perception.detector is one of: {', '.join(names())}.")
    if name == OURS:
        _checked_settings(name, NoSettings, station)
        return None
    factory = _loaded(name)
    settings = _checked_settings(name, getattr(factory, "Settings", NoSettings), station)
    try:
        detector: GraspDetector = factory(station, settings)
    except Exception as error:
        what = f"The detector {name!r} does not start: {type(error).__name__}: {quoted(str(error))}."
        raise ConfigError(what, "Its own documentation says what it needs.") from error
    if lacking := [what for what in ("is_deterministic", "detect", "close") if not hasattr(detector, what)]:
        raise ConfigError(f"The detector {name!r} has no {lacking[0]!r}.", "See docs/extend.md.")
    return detector


def _loaded(name: str) -> Any:
    point = next(point for point in points() if point.name == name)
    try:
        return point.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"The detector {name!r} cannot be loaded: {error}.", "Install what it needs.") from error


def _checked_settings(name: str, model: type[BaseModel], station: Station) -> BaseModel:
    try:
        return model.model_validate(station.perception.settings)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(("perception", "settings", *(str(part) for part in first["loc"])))
        known = ", ".join(model.model_fields) or "none"
        raise ConfigError(
            f"{where}: {first['msg'].removeprefix('Value error, ')} (the detector {name!r} says).",
            f"Its settings: {known}.",
        ) from error
