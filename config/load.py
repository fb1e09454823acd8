"""Reads a station (defaults < station file < ``--set key=value``) and computes its hash, stored in every recording."""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from bus.errors import ConfigError
from config.base import UNSHOWN, is_unicode
from config.schema import Station
from config.toml_file import parsed, read_text

_LONGEST_GIVEN = 200
DEFAULT_STATION = Path(__file__).with_name("sim.toml")
_BESIDE_THE_FILE = (
    ("bus", "zenoh"),
    ("robot", "urdf"),
    ("perception", "hosted", "key_file"),
    *(("http", name) for name in ("certificate", "key", "tokens")),
    *(("opcua", name) for name in ("certificate", "key", "trusted", "users")),
)


def load_station(path: Path | None = None, overrides: Iterable[str] = ()) -> Station:
    """Return the station of the file ``path`` (default: the simulated cell) with ``overrides`` like ``sim.pace=1``.

    Raises:
        ConfigError: names the key and the accepted values.
    """
    file = path or DEFAULT_STATION
    tree = parsed(read_text(file), str(file))
    _place(tree, file.absolute().parent)
    return station_from(tree, overrides, source=str(file))


def station_from(tree: dict[str, Any], overrides: Iterable[str] = (), *, source: str = "the station") -> Station:
    """Return the station of a parsed tree (of a TOML file, or of a recording) with ``overrides`` applied.

    Args:
        source: name of the tree's origin, for error texts.

    Raises:
        ConfigError: names the key and the accepted values.
    """
    for override in overrides:
        _apply(tree, override)
    try:
        return Station.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(*_explain(error, source)) from error


def station_hash(station: Station) -> str:
    """Return the first 16 hex digits of the SHA-256 of the station's canonical JSON."""
    return hashlib.sha256(station.model_dump_json().encode()).hexdigest()[:16]


def _place(tree: dict[str, Any], folder: Path) -> None:
    """Make the paths of Zenoh, key and user files absolute: they are relative to the station file, or to a home."""
    for *path, leaf in _BESIDE_THE_FILE:
        node: Any = tree
        for part in path:
            node = node.get(part) if isinstance(node, dict) else None
        named = node.get(leaf) if isinstance(node, dict) else None
        if isinstance(named, str) and named and not named.startswith("~"):
            node[leaf] = str(folder / named)


def _apply(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not is_unicode(override):
        raise ConfigError(f"What is given for {key!r} is not UTF-8 text.", "Rename it, or set the terminal to UTF-8.")
    if not equals or not key.strip():
        raise ConfigError(f"--set {override!r} is not of the form key=value.", "Example: --set sim.pace=1")
    *path, leaf = key.strip().split(".")
    node = tree
    for part in path:
        child = node.setdefault(part, {})
        if not isinstance(child, dict):
            raise ConfigError(f"--set {override!r}: {part!r} has no keys below it.")
        node = child
    node[leaf] = _value(text.strip(), _takes_text([*path, leaf]))


def _value(text: str, takes_text: bool) -> Any:
    """Parse a TOML value; keep the text where it is none, or where text is wanted (so that neither needs quotes)."""
    try:
        tree = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    value = tree["value"]
    return text if len(tree) > 1 or (takes_text and not isinstance(value, str)) else value


def _takes_text(path: Sequence[str]) -> bool:
    """Whether the setting at ``path`` is a text or a path, and never a number."""
    kinds: list[Any] = [Station]
    for part in path:
        kinds = [inner for kind in kinds for inner in _below(kind, part)]
    types = [kind for kind in kinds if isinstance(kind, type)]
    return any(issubclass(kind, (str, Path)) for kind in types) and not any(issubclass(kind, int) for kind in types)


def _below(kind: Any, part: str) -> list[Any]:
    """Return the types of the setting ``part`` in a table of this ``kind``; empty when there is none."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return _plain(kind.model_fields[part].annotation) if part in kind.model_fields else []
    return _plain(get_args(kind)[1]) if get_origin(kind) is dict else []


def _plain(annotation: Any) -> list[Any]:
    """Return the types behind an annotation, of each of its alternatives."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _plain(arguments[0])
    if origin in (Union, UnionType):
        return [kind for one in arguments for kind in _plain(one)]
    return [type(one) for one in arguments] if origin is Literal else [annotation]


def _explain(error: ValidationError, source: str) -> tuple[str, str]:
    """Return the first error and the advice for it, for a person."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        siblings = _keys_beside(first["loc"])
        near = difflib.get_close_matches(str(first["loc"][-1]), siblings, n=1)
        hint = f"Did you mean {near[0]!r}?" if near else f"Known here: {', '.join(siblings)}."
        return f"Unknown key {where!r} in {source}.", hint
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "missing" and isinstance(first["loc"][-1], int):
        where, message = where.rpartition(".")[0], f"{len(first['input'])} numbers are too few"
    given = repr(first.get("input"))
    given = given if len(given) <= _LONGEST_GIVEN else given[:_LONGEST_GIVEN] + "..."
    shown = "" if first["type"] == UNSHOWN else f" (given: {given})"
    return (
        f"{where or source}: {message}{shown}.",
        "Correct it in the station file or with --set.",
    )


def _keys_beside(location: tuple[int | str, ...]) -> list[str]:
    kinds: list[Any] = [Station]
    for part in location[:-1]:
        kinds = [inner for kind in kinds for inner in _below(kind, str(part))] or kinds
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return sorted(key for model in models for key in model.model_fields)
