"""Every mistake of a station file, with its line: what `cell config check` prints."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from config.load import explained, in_words, tree_of
from config.origins import Place, lines_of
from config.schema import Station
from config.toml_file import BYTE_ORDER_MARK, read_text


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


def mistakes_in(file: Path) -> list[Mistake]:
    """Return every mistake of a station file, in the file's order; empty: a cell can be started with it.

    Raises:
        ConfigError: it cannot be read, or is not valid TOML: then nothing more can be said.
    """
    text = read_text(file)
    tree = tree_of(file, text)
    try:
        Station.model_validate(tree)
    except ValidationError as error:
        return _mistakes(error, tree, str(file), lines_of(text.removeprefix(BYTE_ORDER_MARK)))
    return []


def _mistakes(error: ValidationError, tree: dict[str, Any], file: str, lines: dict[Place, int]) -> list[Mistake]:
    """One mistake a setting, with all that is said of it: each type that it may have says something of its own."""
    said: dict[Place, list[tuple[str, str]]] = {}
    for one in error.errors():
        said.setdefault(_place(one["loc"], tree), []).append(explained(one, "it there"))
    found = []
    for place, reasons in said.items():
        texts = list(dict.fromkeys(text for text, _ in reasons))
        field = in_words(place[-1:]) or "the whole"
        found.append(
            Mistake(file, _line(place, lines), in_words(place[:-1]), field, ", or ".join(texts), reasons[0][1])
        )
    return sorted(found, key=lambda one: one.line or 0)


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
