"""The words for a target that are understood without a model: colours, superlatives, and the station's labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

from config.target import Color, Label

COLORS: tuple[str, ...] = get_args(Color)
SAME_COLOR = {"gray": "grey", "violet": "purple", "magenta": "pink", "turquoise": "cyan"}
SUPERLATIVES: dict[str, str] = {
    "largest": "largest",
    "biggest": "largest",
    "smallest": "smallest",
    "tallest": "tallest",
    "highest": "highest",
    "flattest": "flattest",
    "longest": "longest",
    "shortest": "shortest",
    "leftmost": "leftmost",
    "rightmost": "rightmost",
    "nearest": "nearest",
    "closest": "nearest",
    "farthest": "farthest",
    "furthest": "farthest",
}
"""Each word, and the one it means: size by volume, ``highest`` by its top, left and right in the picture, near and far
from the robot's base."""
_FILLERS = frozenset({"a", "an", "any", "it", "object", "of", "one", "part", "please", "the", "thing"})


@dataclass(frozen=True)
class Wanted:
    """The wish that a target's words express: things of one colour, of one label, and the utmost of them."""

    color: str | None = None
    label: Label | None = None
    superlative: str | None = None


def understood(text: str, labels: Sequence[Label]) -> Wanted:
    """Return the meaning of a target's words. Raises: ValueError, which names the words that are not understood."""
    by_name = {label.name: label for label in labels}
    wanted, unknown = Wanted(), list[str]()
    for word in text.lower().replace(",", " ").split():
        if word in _FILLERS:
            continue
        found = _meaning(word, by_name)
        if found is None:
            unknown.append(word)
        elif any(getattr(wanted, name) not in (None, value) for name, value in vars(found).items() if value):
            raise ValueError(f"{text!r} asks for two things at once: {word!r} goes with no other word of its kind")
        else:
            wanted = Wanted(*(new or old for new, old in zip(vars(found).values(), vars(wanted).values(), strict=True)))
    if unknown or wanted == Wanted():
        what = ", ".join(repr(word) for word in unknown) or "nothing in it"
        raise ValueError(f"of {text!r} this cell does not understand: {what}. It understands {vocabulary(labels)}")
    return wanted


def vocabulary(labels: Sequence[Label]) -> str:
    """Return the understood words, for a person."""
    names = ", ".join(label.name for label in labels) or "none in this station (perception.labels)"
    return f"colours ({', '.join(COLORS)}), {', '.join(dict.fromkeys(SUPERLATIVES))}; labels: {names}"


def _meaning(word: str, labels: dict[str, Label]) -> Wanted | None:
    color = SAME_COLOR.get(word, word)
    if word in labels:  # a station may mean something of its own by "orange"
        return Wanted(label=labels[word])
    if color in COLORS:
        return Wanted(color=color)
    if word in SUPERLATIVES:
        return Wanted(superlative=SUPERLATIVES[word])
    return None
