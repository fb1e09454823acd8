"""Reads a station (defaults < station file < ``--set key=value``) and computes its hash, stored in every recording."""

from __future__ import annotations

import difflib
import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from bus.errors import ConfigError
from bus.first_mistake import field_name, reason
from config.base import TOGETHER, UNSHOWN
from config.keys import keys_beside, namesakes, nearest
from config.overrides import Override, applied, around, named, set_by
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


def load_station(
    path: Path | None = None, overrides: Iterable[str] = (), *, given_by: Mapping[str, str] | None = None
) -> Station:
    """Return the station of the file ``path`` (default: the simulated cell) with ``overrides`` like ``sim.pace=1``.

    Args:
        given_by: as in `station_from`.

    Raises:
        ConfigError: names the key, where it was given, and the accepted values.
    """
    file = path or DEFAULT_STATION
    more = f"`cell config check {file}` names every mistake with its line." if path is not None else ""
    return station_from(tree_of(file, read_text(file)), overrides, source=str(file), given_by=given_by, more=more)


def tree_of(file: Path, text: str) -> dict[str, Any]:
    """Return the tree of the station file ``file``, whose content is ``text``; its paths are absolute.

    Raises:
        ConfigError: it is not valid TOML.
    """
    tree = parsed(text, str(file))
    _place(tree, file.absolute().parent)
    return tree


def station_from(
    tree: dict[str, Any],
    overrides: Iterable[str] = (),
    *,
    source: str = "the station",
    given_by: Mapping[str, str] | None = None,
    more: str = "",
) -> Station:
    """Return the station of a parsed tree (of a TOML file, or of a recording) with ``overrides`` applied.

    Args:
        tree: it stays as it is.
        source: name of the tree's origin, for error texts. ``given_by``: where overrides were given, by their keys, as
            ``{"sim.seed": "--seed"}``; else it was by ``--set``. ``more``: further advice about a mistake of the tree.

    Raises:
        ConfigError: names the key, where it was given, and the accepted values.
    """
    given = named(overrides, given_by)
    try:
        return Station.model_validate(applied(tree, given))
    except ValidationError as error:
        first = placed(error.errors()[0])
        blamed = _blamed(tree, given, first)
        text, advice = _of_file(first, source) if blamed is None else _of_override(first, blamed)
        raise ConfigError(text, f"{advice} {more}".strip() if blamed is None else advice) from error


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


def _blamed(tree: dict[str, Any], given: Sequence[Override], mistake: ErrorDetails) -> Override | None:
    """Return the override that makes a mistake; None = the tree does, as it was before."""
    place = tuple(str(part) for part in mistake["loc"])
    if (own := set_by(given, place)) is not None or _is_in(tree, mistake):
        return own
    suspects = around(given, place)
    cured = (one for one in suspects if not _is_in(applied(tree, [left for left in given if left is not one]), mistake))
    return next(cured, suspects[0] if suspects else None)


def _is_in(tree: dict[str, Any], mistake: ErrorDetails) -> bool:
    try:
        Station.model_validate(tree)
    except ValidationError as error:
        return any(
            (one["loc"], one["type"]) == (mistake["loc"], mistake["type"]) for one in map(placed, error.errors())
        )
    return False


def placed(mistake: ErrorDetails) -> ErrorDetails:
    """Return a mistake of several settings together as that of the one to look at first; any other as it is."""
    if mistake["type"] != TOGETHER:
        return mistake
    given: Any = mistake["input"]
    names: list[str] = mistake["ctx"]["setting"].split(".")
    for name in names:
        given = given.get(name, {}) if isinstance(given, dict) else {}
    return {**mistake, "loc": (*mistake["loc"], *names), "input": given}


def _of_file(mistake: ErrorDetails, source: str) -> tuple[str, str]:
    """Return a mistake of the tree, and the advice for it, for a person; ``source``: where it stands."""
    where, (text, advice) = field_name(mistake), explained(mistake, source)
    if mistake["type"] == "extra_forbidden":
        return f"Unknown key {where!r} in {source}.", _meant(mistake["loc"])
    if text == MISSING:
        return f"{where} {text} in {source}.", advice
    return f"{where or source}: {text}.", advice


def _of_override(mistake: ErrorDetails, given: Override) -> tuple[str, str]:
    """Return a mistake that an override makes, and the advice for it."""
    place = tuple(str(part) for part in mistake["loc"])
    text, advice = explained(mistake, given.where)
    if mistake["type"] == "extra_forbidden":
        whole = given.path if given.path[: len(place)] == place else place
        return f"Unknown key {_dotted(whole)!r} in {given.where}.", _meant(whole)
    if text == MISSING:
        return f"{_dotted(place)} {text}, with {given.where}.", "Give it, too."
    return f"{_dotted(place or given.path)}: {text}.", advice


def _dotted(path: Sequence[int | str]) -> str:
    return ".".join(str(part) for part in path)


def _meant(path: Sequence[int | str], beside: str = "") -> str:
    """Return the setting that was meant by an unknown one, or those that there are in its table.

    Args:
        beside: left out of the name, where the reader is told the table.
    """
    near = nearest([str(part) for part in path])
    if near:
        return f"Did you mean {near.removeprefix(beside)!r}?"
    elsewhere = ", ".join(namesakes(str(path[-1])))
    return f"Known here: {', '.join(keys_beside(path))}{f'; elsewhere: {elsewhere}' if elsewhere else ''}."


def explained(mistake: ErrorDetails, where: str) -> tuple[str, str]:
    """Return what is wrong with one setting, without its name and without a full stop, and the advice for it.

    Args:
        where: it was given: what is to be corrected.
    """
    location, kind = mistake["loc"], mistake["type"]
    if kind == "extra_forbidden":
        return "unknown key", _meant(location, beside=f"{_dotted(location[:-1])}.")
    if kind == "missing" and location == ("nodes",):
        return MISSING, "Is this a part of a station file? `cell config new FILE [--simulated]` writes a whole one."
    if kind == "missing" and not isinstance(location[-1], int):
        return MISSING, f"Give it in [{table}]." if (table := in_words(location[:-1])) else "Give it."
    text = reason(mistake).replace("Input should be", "must be")
    if kind == "missing":
        text = f"{len(mistake['input'])} numbers are too few"
    return f"{text}{_given(mistake)}", _corrected(mistake, where)


def in_words(path: Sequence[int | str]) -> str:
    """A table's or a setting's name: ``scene.bins.2.size_m`` is in the second of the bins."""
    return ".".join(str(part + 1) if isinstance(part, int) else part for part in path)


def _corrected(mistake: ErrorDetails, where: str) -> str:
    """Return what to do about a value that cannot be: the word that was meant, if it is like one of those there are."""
    given, words = mistake.get("input"), mistake.get("ctx", {}).get("expected", "")
    if mistake["type"] == "literal_error" and isinstance(given, str):
        near = difflib.get_close_matches(given, re.findall(r"'([^']*)'", words), n=1)
        if near:
            return f"Did you mean {near[0]!r}?"
    return f"Correct {where}."


def _given(mistake: ErrorDetails) -> str:
    if mistake["type"] == UNSHOWN or isinstance(mistake.get("input"), dict):  # a secret; a table is too long to help
        return ""
    given = repr(mistake.get("input"))
    return f" (given: {given if len(given) <= _LONGEST_GIVEN else given[:_LONGEST_GIVEN] + '...'})"
