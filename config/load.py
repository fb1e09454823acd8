"""Reads a station: defaults < station file < ``--set key=value``; and its hash, which every recording carries."""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from bus.errors import ConfigError
from config.base import UNSHOWN
from config.schema import Station

DEFAULT_STATION = Path(__file__).with_name("sim.toml")


def load_station(path: Path | None = None, overrides: Iterable[str] = ()) -> Station:
    """The station described by ``path`` (default: the simulated cell) with ``overrides`` like ``sim.pace=1``.

    Raises: ConfigError naming the key and what is accepted.
    """
    file = path or DEFAULT_STATION
    try:
        tree = tomllib.loads(file.read_text())
    except FileNotFoundError as error:
        raise ConfigError(f"There is no station file {file}.", "Name one with --config FILE.toml.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"Cannot read the station file {file}: {error}.") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{file} is not valid TOML: {error}.") from error
    _place(tree, file.absolute().parent)
    return station_from(tree, overrides, source=str(file))


def station_from(tree: dict[str, Any], overrides: Iterable[str] = (), *, source: str = "the station") -> Station:
    """The station of a parsed tree (a TOML file's, or a recording's) with ``overrides`` applied."""
    for override in overrides:
        _apply(tree, override)
    try:
        return Station.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(*_explain(error, source)) from error


def station_hash(station: Station) -> str:
    """SHA-256 of the station's canonical JSON, first 16 hex digits."""
    return hashlib.sha256(station.model_dump_json().encode()).hexdigest()[:16]


def _place(tree: dict[str, Any], folder: Path) -> None:
    """Paths of the Zenoh and key files are relative to the station file, wherever the command runs."""
    for *path, leaf in (("bus", "zenoh"), ("perception", "hosted", "key_file")):
        node: Any = tree
        for part in path:
            node = node.get(part) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(leaf), str):
            node[leaf] = str(folder / Path(node[leaf]).expanduser())


def _apply(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set {override!r} is not of the form key=value.", "Example: --set sim.pace=1")
    *path, leaf = key.strip().split(".")
    node = tree
    for part in path:
        child = node.setdefault(part, {})
        if not isinstance(child, dict):
            raise ConfigError(f"--set {override!r}: {part!r} has no keys below it.")
        node = child
    node[leaf] = _value(text.strip())


def _value(text: str) -> Any:
    """A TOML value, or the text itself where it is none (so that paths need no quotes)."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _explain(error: ValidationError, source: str) -> tuple[str, str]:
    """The first thing wrong, and what to do, for a person."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        siblings = _keys_beside(first["loc"])
        near = difflib.get_close_matches(str(first["loc"][-1]), siblings, n=1)
        hint = f"Did you mean {near[0]!r}?" if near else f"Known here: {', '.join(siblings)}."
        return f"Unknown key {where!r} in {source}.", hint
    message = first["msg"].removeprefix("Value error, ")
    given = "" if first["type"] == UNSHOWN else f" (given: {first.get('input')!r})"
    return (
        f"{where or source}: {message}{given}.",
        "Correct it in the station file or with --set.",
    )


def _keys_beside(location: tuple[int | str, ...]) -> list[str]:
    model: type[BaseModel] = Station
    for part in location[:-1]:
        field = model.model_fields.get(str(part))
        kind = field.annotation if field is not None else None
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            model = kind
    return sorted(model.model_fields)
