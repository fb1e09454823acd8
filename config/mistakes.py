"""Every mistake of a station file, with its line: what `cell config check` prints.

What is wrong of several settings together (`config.base.wrong`) is looked for with every wrong setting left out, so
that it is named beside the others; not where it may come from that: it follows once these are right.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from config.base import TOGETHER
from config.load import explained, in_words, placed, tree_of
from config.origins import Place, lines_of
from config.schema import Station
from config.standing import boxes_in_region
from config.toml_file import BYTE_ORDER_MARK, read_text

_MOST_ROUNDS = 8


class Mistake(NamedTuple):
    """One mistake of a station file.

    Attributes:
        line: from 1 on; None where the file lacks a whole table.
        section, field: the table's name, "" at the top of the file, and the setting's in it.
    """

    file: str
    line: int | None
    section: str
    field: str
    text: str
    advice: str

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        return f"{place}: {f'[{self.section}] ' if self.section else ''}{self.field}: {self.text}. {self.advice}"


class Said(NamedTuple):
    """The mistake in the setting or table at ``place``, without its name and without a full stop, and the advice."""

    place: Place
    text: str
    advice: str


Check = Callable[[Station], Iterable[Said]]
"""Looks at a station that the schema accepts."""


def mistakes_in(file: Path, further: Check = lambda station: ()) -> list[Mistake]:
    """Return every mistake of a station file, in the file's order; empty: a cell can be started with it.

    Args:
        further: says what else is wrong, of what this module cannot know.

    Raises:
        ConfigError: it cannot be read, or is not valid TOML: then nothing more can be said.
    """
    text = read_text(file)
    said: dict[Place, list[Said]] = {}
    for one in _said(tree_of(file, text), lambda station: (*_standing(station), *further(station))):
        said.setdefault(one.place, []).append(one)
    lines = lines_of(text.removeprefix(BYTE_ORDER_MARK)) if said else {}
    found = [_mistake(str(file), _line(place, lines), reasons) for place, reasons in said.items()]
    return sorted(found, key=lambda one: one.line or 0)


def _mistake(file: str, line: int | None, reasons: list[Said]) -> Mistake:
    """One mistake a setting, with all that is said of it: each type that it may have says something of its own."""
    place, texts = reasons[0].place, list(dict.fromkeys(one.text for one in reasons))
    field = in_words(place[-1:]) or "the whole"
    return Mistake(file, line, in_words(place[:-1]), field, ", or ".join(texts), reasons[0].advice)


def _said(tree: dict[str, Any], further: Check) -> Iterator[Said]:
    """Yield what is wrong of each setting, then of several together, then what else is wrong."""
    left_out: list[Place] = []
    for _ in range(_MOST_ROUNDS):
        try:
            station = Station.model_validate(tree)
        except ValidationError as error:
            mistakes = [placed(one) for one in error.errors()]
        else:
            yield from (one for one in further(station) if _is_sure(one.text, left_out))
            return
        for one in mistakes:
            if not left_out or (_is_of_several(one, left_out) and _is_sure(one["msg"], left_out)):
                yield Said(_place(one["loc"], tree), *explained(one, "it there"))
        wrong = [_place(one["loc"], tree) for one in mistakes if one["type"] != "missing"]
        if not all(wrong) or len(wrong) < len(mistakes):
            return
        tree, left_out = _without(tree, wrong), [*left_out, *wrong]


def _standing(station: Station) -> Iterator[Said]:
    for place, text in boxes_in_region(station.scene):
        yield Said(place, text, "Move the box or the region; both are in metres, in `base`.")


def _is_of_several(mistake: ErrorDetails, left_out: Iterable[Place]) -> bool:
    """Whether it is of settings that are all there."""
    table = mistake["loc"]
    return mistake["type"] == TOGETHER or (
        mistake["type"] == "value_error" and not any(one[: len(table)] == table for one in left_out)
    )


def _is_sure(text: str, left_out: Iterable[Place]) -> bool:
    """Whether a mistake is none of settings that were left out: it names none of them."""
    return not any(re.search(rf"\b{re.escape(str(one[-1]))}\b", text) for one in left_out)


def _without(tree: dict[str, Any], places: Iterable[Place]) -> dict[str, Any]:
    """Return the tree without the settings at these places; without the whole list where it is in one of its tables."""
    tree = copy.deepcopy(tree)
    for place in places:
        first = next((at for at, part in enumerate(place) if isinstance(part, int)), len(place))
        *path, leaf = place[:first]
        table: Any = tree
        for part in path:
            table = table.get(part, {})
        table.pop(leaf, None)
    return tree


def _place(location: tuple[int | str, ...], tree: Any) -> Place:
    """The setting at a location of pydantic: what follows it names one of its types, or one number of a list."""
    place: Place = ()
    for part in location:
        if isinstance(tree, dict) and isinstance(part, str):
            tree = tree.get(part)
        elif isinstance(tree, list) and isinstance(part, int) and part < len(tree) and isinstance(tree[part], dict):
            tree = tree[part]
        else:
            break
        place = (*place, part)
    return place


def _line(place: Place, lines: dict[Place, int]) -> int | None:
    """The line of a setting, or of the table that lacks it."""
    while place and place not in lines:
        place = place[:-1]
    return lines.get(place)
