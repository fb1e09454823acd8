"""Reads the station that a caller names: a file, an object, or none; with single settings changed."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from bus.errors import ConfigError
from config.load import load_station, station_from
from config.schema import Station
from config.toml_text import toml_value

Config = Station | str | Path | None
"""A station, or the path of its TOML file; None = the simulated cell."""
Settings = Mapping[str, Any]
"""Settings by their full names, as ``{"scene.pick_region_m": [0.3, 0.6, -0.2, 0.2]}``; a table is a dict, several are a
list of them: ``{"scene.places": [{"name": "left", "position_m": [0.4, 0.4, 0.2]}]}``."""


def station_of(
    config: Config = None, settings: Settings | None = None, arguments: Mapping[str, tuple[str, Any]] | None = None
) -> Station:
    """Return the station with these settings changed.

    Args:
        arguments: what else is set, of a caller's arguments: ``{"region_m": ("scene.pick_region_m", [0, 1, 0, 1])}``;
            without those that are None. They count, and not the settings.

    Raises: ConfigError, which names the key, the argument that gave it, and what is accepted.
    """
    if not isinstance(settings, Mapping | None):
        what = f"settings is of {type(settings).__name__}, and no dict."
        raise ConfigError(what, 'Name each setting with its value: settings={"hand.max_width_m": 0.05}.')
    if not isinstance(config, Station | str | PathLike | None):
        what = f"config is of {type(config).__name__}, and no path of a station file."
        raise ConfigError(what, 'Single settings go into settings: settings={"hand.max_width_m": 0.05}.')
    given: dict[str, Any] = dict(settings or {})
    given_by = {key: f"settings[{key!r}]" for key in given}
    for name, (key, value) in (arguments or {}).items():
        if value is not None:
            given[key], given_by[key] = value, name
    overrides = [f"{key}={_written(key, value, given_by[key])}" for key, value in given.items()]
    if not isinstance(config, Station):
        return load_station(Path(config) if config is not None else None, overrides, given_by=given_by)
    if not overrides:
        return config
    return station_from(config.model_dump(mode="json"), overrides, source="config", given_by=given_by)


def _written(key: str, value: Any, where: str) -> str:
    """The value as TOML writes it; a dict is an inline table."""
    try:
        return toml_value(_plain(value))
    except TypeError as error:
        raise ConfigError(
            f"{key} is of {type(value).__name__}.",
            f"Correct {where}: a number, a text, a boolean, a dict, or a list of them.",
        ) from error


def _plain(value: Any) -> Any:
    """The value without arrays; a None in a dict counts as not given."""
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items() if one is not None}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value
