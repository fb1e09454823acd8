"""The origin of each setting of a station: a line of its file, ``--set``, or the default."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from pydantic import BaseModel

from config.schema import Station

Place = tuple[str | int, ...]
"""A setting's name, table by table; a number counts the tables of one ``[[name]]``, from 0 on."""


class Setting(NamedTuple):
    """One setting as it counts. ``origin``: ``default``, ``--set``, or the line of the file."""

    name: str
    value: Any
    origin: str


def settings(station: Station, text: str, file: str, overrides: Iterable[str] = ()) -> Iterator[Setting]:
    """Yield every setting of the station, in the schema's order, with its origin.

    Args:
        text: of the station file ``file``. ``overrides``: what was given with ``--set``.
    """
    lines, given = lines_of(text), [one.partition("=")[0].strip() for one in overrides]
    for path, value in _leaves(station):
        name = ".".join(path)
        if any(name == one or name.startswith(f"{one}.") for one in given):
            yield Setting(name, value, "--set")
        else:
            line = next((at for where, at in lines.items() if where[: len(path)] == path), None)
            yield Setting(name, value, "default" if line is None else f"{file}:{line}")


def leaves(station: Station) -> dict[str, Any]:
    """Return every setting of the station that is no table of settings itself, by name; a list is one setting."""
    return {".".join(path): value for path, value in _leaves(station)}


def _leaves(table: BaseModel | dict[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every setting that is no table of settings itself. An empty table of named tables is left out."""
    for name, value in table.items() if isinstance(table, dict) else table:
        if isinstance(value, BaseModel | dict):
            yield from _leaves(value, (*path, name))
        else:
            yield (*path, name), value


def lines_of(text: str) -> dict[Place, int]:
    """Return the line, from 1 on, on which each key and each table of a TOML text begins.

    The text must be valid TOML. A statement of several lines begins on its first.
    """
    found: dict[Place, int] = {}
    table: Place = ()
    for line, statement in _statements(text):
        tree = tomllib.loads(statement)
        if statement.lstrip().startswith("["):
            table = _counted(_path(tree), found)
            found[table] = line
        else:
            for path in _paths(tree):
                found.setdefault((*table, *path), line)
    return found


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield each statement with the line that it begins on: lines are joined until they are valid TOML."""
    pending, began = "", 0
    for line, part in enumerate(text.splitlines(keepends=True), start=1):
        if not pending:
            if part.isspace() or part.lstrip().startswith("#"):
                continue
            began = line
        pending += part
        try:
            tomllib.loads(pending)
        except ValueError:
            continue
        yield began, pending
        pending = ""


def _path(tree: Any) -> Place:
    """The name of the one table in a tree that a head alone makes; a 0 where it is one of several."""
    path: list[str | int] = []
    while tree:
        ((name, tree),) = tree.items()
        path.append(name)
        if isinstance(tree, list):
            path.append(0)
            (tree,) = tree
    return tuple(path)


def _counted(path: Place, found: dict[Place, int]) -> Place:
    """The path with the number that the tables of one name have so far; ``path`` names the first of each."""
    counted: Place = ()
    for place, part in enumerate(path):
        if isinstance(part, int):
            number = sum(1 for one in found if len(one) == len(counted) + 1 and one[:-1] == counted)
            is_new = place == len(path) - 1
            part = number if is_new else number - 1
        counted = (*counted, part)
    return counted


def _paths(tree: Any, path: Place = ()) -> Iterator[Place]:
    """The path of every key in a tree, those inside of inline tables too."""
    inside = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for name, below in inside:
        yield (*path, name)
        yield from _paths(below, (*path, name))
