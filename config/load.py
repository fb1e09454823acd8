"""Reads a station (defaults < station file < ``--set key=value``) and computes its hash, stored in every recording."""

from __future__ import annotations

import difflib
import hashlib
import re
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from bus.errors import ConfigError
from bus.first_mistake import field_name, reason
from config.base import UNSHOWN, is_unicode
from config.schema import Station
from config.toml_file import parsed, read_text

_LONGEST_GIVEN = 200
MISSING = "is missing"
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
    return station_from(tree_of(file, read_text(file)), overrides, source=str(file))


def tree_of(file: Path, text: str) -> dict[str, Any]:
    """Return the tree of the station file ``file``, whose content is ``text``; its paths are absolute.

    Raises:
        ConfigError: it is not valid TOML.
    """
    tree = parsed(text, str(file))
    _place(tree, file.absolute().parent)
    return tree


def station_from(tree: dict[str, Any], overrides: Iterable[str] = (), *, source: str = "the station") -> Station:
    """Return the station of a parsed tree (of a TOML file, or of a recording) with ``overrides`` applied.

    Args:
        tree: it stays as it is.
        source: name of the tree's origin, for error texts.

    Raises:
        ConfigError: names the key and the accepted values.
    """
    tree = dict(tree)
    for override in overrides:
        _apply(tree, override)
    try:
        return Station.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(*_said(error, source)) from error


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
        child = node.get(part, {})
        if not isinstance(child, dict):
            raise ConfigError(f"--set {override!r}: {part!r} has no keys below it.")
        node[part] = node = dict(child)  # a recording's station stays as it is
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


def _said(error: ValidationError, source: str) -> tuple[str, str]:
    """Return the first mistake and the advice for it, for a person; ``source``: where it stands."""
    first = error.errors()[0]
    where, (text, advice) = field_name(first), explained(first)
    if first["type"] == "extra_forbidden":
        return f"Unknown key {where!r} in {source}.", advice
    if text == MISSING:
        return f"{where} {text} in {source}.", advice
    return f"{where or source}: {text}.", advice


def explained(mistake: ErrorDetails) -> tuple[str, str]:
    """Return what is wrong with one setting, without its name and without a full stop, and the advice for it."""
    location, kind = mistake["loc"], mistake["type"]
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(str(location[-1]), names := _keys_beside(location), n=1)
        return "unknown key", f"Did you mean {near[0]!r}?" if near else f"Known here: {', '.join(names)}."
    if kind == "missing" and location == ("nodes",):
        return MISSING, "Is this a part of a station file? `cell config new FILE [--simulated]` writes a whole one."
    if kind == "missing" and not isinstance(location[-1], int):
        return MISSING, f"Give it in [{table}]." if (table := named(location[:-1])) else "Give it."
    text = reason(mistake).replace("Input should be", "must be")
    if kind == "missing":
        text = f"{len(mistake['input'])} numbers are too few"
    return f"{text}{_given(mistake)}", _corrected(mistake)


def named(path: Sequence[int | str]) -> str:
    """A table's or a setting's name: ``scene.bins.2.size_m`` is in the second of the bins."""
    return ".".join(str(part + 1) if isinstance(part, int) else part for part in path)


def _corrected(mistake: ErrorDetails) -> str:
    """Return what to do about a value that cannot be: the word that was meant, if it is like one of those there are."""
    given, words = mistake.get("input"), mistake.get("ctx", {}).get("expected", "")
    if mistake["type"] == "literal_error" and isinstance(given, str):
        near = difflib.get_close_matches(given, re.findall(r"'([^']*)'", words), n=1)
        if near:
            return f"Did you mean {near[0]!r}?"
    return "Correct it in the station file or with --set."


def _given(mistake: ErrorDetails) -> str:
    if mistake["type"] == UNSHOWN:
        return ""
    given = repr(mistake.get("input"))
    return f" (given: {given if len(given) <= _LONGEST_GIVEN else given[:_LONGEST_GIVEN] + '...'})"


def _keys_beside(location: tuple[int | str, ...]) -> list[str]:
    kinds: list[Any] = [Station]
    for part in location[:-1]:
        kinds = [inner for kind in kinds for inner in _below(kind, str(part))] or kinds
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return sorted(key for model in models for key in model.model_fields)
