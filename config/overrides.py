"""Single settings that are given beside a station: applied to its tree, and named when they are wrong."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from bus.errors import ConfigError
from config.base import is_unicode
from config.keys import takes_text

_LONGEST_SHOWN = 60


class Override(NamedTuple):
    """One setting. ``path``: its name, table by table. ``where``: it was given, in words."""

    text: str
    path: tuple[str, ...]
    where: str


def named(texts: Iterable[str], given_by: Mapping[str, str] | None = None) -> tuple[Override, ...]:
    """Return settings given as ``key=value``, in the order in which they count.

    Args:
        given_by: where a setting was given, by its key: ``{"sim.seed": "--seed"}``. Else it was by ``--set``.
    """
    return tuple(_named(text, given_by or {}) for text in texts)


def applied(tree: dict[str, Any], overrides: Sequence[Override]) -> dict[str, Any]:
    """Return the tree of a station with these settings; the one given is left as it is. Raises: ConfigError."""
    tree = copy.deepcopy(tree) if overrides else tree
    for one in overrides:
        _apply(tree, one)
    return tree


def set_by(overrides: Sequence[Override], place: tuple[str, ...]) -> Override | None:
    """Return the override that counts for the setting at a place of the tree; None = it was not overridden."""
    return next((one for one in reversed(overrides) if place[: len(one.path)] == one.path), None)


def around(overrides: Sequence[Override], place: tuple[str, ...]) -> list[Override]:
    """Return the overrides of what is below a place of the tree, or beside it, the last one first."""
    return [one for one in reversed(overrides) if one.path[: len(place)] == place or one.path[:-1] == place[:-1] != ()]


def _named(text: str, given_by: Mapping[str, str]) -> Override:
    key, equals, _ = text.partition("=")
    key = key.strip()
    whole = repr(text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "...")
    shown = key if equals and key else whole  # a value may be a secret where none belongs
    return Override(text, tuple(key.split(".")), given_by.get(key, f"--set {shown}"))


def _apply(tree: dict[str, Any], override: Override) -> None:
    key, equals, text = override.text.partition("=")
    if not is_unicode(override.text):
        raise ConfigError(f"What is given for {key!r} is not UTF-8 text.", "Rename it, or set the terminal to UTF-8.")
    if not equals or not key.strip():
        raise ConfigError(f"{override.where} is not of the form key=value.", "Example: --set sim.pace=1")
    *path, leaf = override.path
    node = tree
    for part in path:
        child = node.setdefault(part, {})
        if not isinstance(child, dict):
            raise ConfigError(
                f"{override.where}: {part!r} has no keys below it.", f"Set {part!r} itself, or another key."
            )
        node = child
    node[leaf] = _value(text.strip(), takes_text([*path, leaf]))


def _value(text: str, wants_text: bool) -> Any:
    """Parse a TOML value; keep the text where it is none, or where text is wanted (so that neither needs quotes)."""
    try:
        tree = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    value = tree["value"]
    return text if len(tree) > 1 or (wants_text and not isinstance(value, str)) else value
