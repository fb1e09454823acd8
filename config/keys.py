"""The names of all settings, as the schema has them: what stands beside a key, and which key was meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from config.schema import Station

_LIKE = 0.7
"""Least likeness of two full names that one of them may be meant by the other."""


def takes_text(path: Sequence[str]) -> bool:
    """Whether the setting at ``path`` is a text or a path, and never a number."""
    types = [kind for kind in _at(path) if isinstance(kind, type)]
    return any(issubclass(kind, (str, Path)) for kind in types) and not any(issubclass(kind, int) for kind in types)


def is_there(path: Sequence[str]) -> bool:
    """Whether there is a setting, or a table, at ``path``; in a plug-in's own table every key counts as one."""
    return bool(_at(path))


def value_at(tree: Any, key: str) -> Any:
    """Return the value of the setting ``key`` in a station as JSON has it; None where its table is not there."""
    for part in key.split("."):
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


def keys_beside(location: Sequence[int | str]) -> list[str]:
    """Return the keys of the table that the last part of ``location`` is in, sorted; or of the last table there is."""
    kinds: list[Any] = [Station]
    for part in location[:-1]:
        kinds = [inner for kind in kinds for inner in _below(kind, str(part))] or kinds
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return sorted(key for model in models for key in model.model_fields)


def nearest(path: Sequence[str]) -> str | None:
    """Return the full name of the setting most like an unknown one; None = none is like it.

    Where its table is there, only what is beside it counts: an ``http.address`` is not the ``fr3.address``.

    Args:
        path: of the unknown setting, table by table.
    """
    *table, leaf = path
    if _at(table) and (near := difflib.get_close_matches(leaf, keys_beside(path), n=1)):
        return ".".join((*table, near[0]))
    if table and _at(table):
        return None
    known = list(_names(Station))
    for names, wanted, least in ((namesakes(leaf), path, 0.5), (known, path, _LIKE), (known, table, _LIKE)):
        if found := difflib.get_close_matches(".".join(wanted), names, n=1, cutoff=least):
            return found[0]
    return None


def namesakes(leaf: str) -> list[str]:
    """Return the full names of all settings that are called ``leaf`` in their table."""
    return [one for one in _names(Station) if one.rpartition(".")[2] == leaf]


def _names(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """The full names of all settings and tables, without what is in tables that a station names itself."""
    for key, field in model.model_fields.items():
        yield prefix + key
        for kind in _plain(field.annotation):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from _names(kind, f"{prefix}{key}.")


def _at(path: Sequence[str]) -> list[Any]:
    """The types of the setting at ``path``; empty when there is none."""
    kinds: list[Any] = [Station]
    for part in path:
        kinds = [inner for kind in kinds for inner in _below(kind, part)]
    return kinds


def _below(kind: Any, part: str) -> list[Any]:
    """The types of the setting ``part`` in a table of this ``kind``; empty when there is none."""
    if kind is Any:
        return [Any]
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return _plain(kind.model_fields[part].annotation) if part in kind.model_fields else []
    return _plain(get_args(kind)[1]) if get_origin(kind) is dict else []


def _plain(annotation: Any) -> list[Any]:
    """The types behind an annotation, of each of its alternatives."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _plain(arguments[0])
    if origin in (Union, UnionType):
        return [kind for one in arguments for kind in _plain(one)]
    return [type(one) for one in arguments] if origin is Literal else [annotation]
