"""THE table of what makes cycles alike, and the matrix of it.

Each feature is scaled to 0..1, so that a distance is a share: 0 = nothing differs, 1 = all that is compared differs.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from logs.catalogue.catalogue import Catalogue
from logs.catalogue.columns import COLUMNS

Array = npt.NDArray[np.float32]
Labels = npt.NDArray[np.intp]
Kind = Literal["number", "word", "counts", "values", "part", "sentence"]


class Feature(NamedTuple):
    """One column that is compared.

    Attributes:
        kind: ``word``: equal or not. ``counts``: a JSON object or list, compared by its shares. ``values``: a JSON
            object of numbers, each a feature. ``part``: the part of the cell that a sentence speaks of first.
            ``sentence``: free words; their first sentence is compared, without numbers and names in quotes.
        share: how many features of its family it counts as.
        is_when: it says when the fault struck, which does not part groups.
    """

    column: str
    kind: Kind = "number"
    share: float = 1.0
    is_when: bool = False


_REASON = (Feature("reason", "part", 2.0), Feature("reason", "sentence", 3.0))
"""A sentence says most of how a cycle ended; whom it speaks of is but one of its words."""


FAMILIES: dict[str, tuple[float, tuple[Feature, ...]]] = {
    "how it ended": (0.40, (Feature("code", "word"), Feature("failed_stage", "word", is_when=True),
                            Feature("stopped_in", "word", is_when=True), *_REASON)),
    "what was rejected": (0.15, (Feature("rejected_codes", "counts"), Feature("tried_codes", "counts"),
                                 Feature("in_the_way", "counts"), Feature("looked_again", "counts"))),
    "what was seen": (0.15, tuple(map(Feature, ("thing_length_m", "thing_width_m", "thing_height_m", "thing_top_m",
                                                "thing_depth_share", "region_seen", "instances", "looks",
                                                "table_offset_m", "table_tilt_rad")))),
    "the grasp": (0.15, (Feature("terms", "values"), *map(Feature, (
        "score", "width_m", "opening_m", "grasp_x_m", "grasp_y_m", "grasp_z_m", "lean_rad", "tilt_rad", "agreement",
        "drift_iou", "align_residual")))),
    "the motion": (0.10, tuple(map(Feature, ("reach_s", "carry_s", "place_s", "torque_max_nm", "tracking_max_rad",
                                             "contact_n", "closed_m", "width_min_m", "load_n", "cleared_fraction",
                                             "joint_margin_rad")))),
    "who stepped in": (0.05, tuple(map(Feature, ("stops", "aborts", "holds", "warnings", "errors",
                                                 "model_failures")))),
}  # fmt: skip
"""Family -> its weight (1 together), and its features, which share it."""
GROUPING = {"how it ended": 0.70, "what was rejected": 0.15, "what was seen": 0.05, "the grasp": 0.05,
            "the motion": 0.05, "who stepped in": 0.0}  # fmt: skip
"""The weights (1 together) by which failures are grouped: what a cycle never came to does not part it from another."""

_PART = re.compile(r"\b(camera|arm|joint|hand|node|disk|model|table)\b")
_QUOTED = re.compile(r"'[^']*'")
_FIRST = re.compile(r"(?<=[.!?])\s")
_FLOOR = {"m": 5e-3, "rad": 0.05, "N": 0.3, "Nm": 0.5, "s": 0.2, "": 0.05}
"""A spread smaller than this is noise, and is not scaled up to something."""
_REACH = 3.0
"""Numbers farther from the median than so many spreads are all equally far."""
_NUMBER = re.compile(r"[-+]?\d+(?:[.,:]\d+)*")
_WORD = re.compile(r"\w+")
_UNITS = {column.name: column.unit for column in COLUMNS}


class Part(NamedTuple):
    """The columns of the matrix that are of one feature, and the feature's family."""

    name: str
    family: str
    columns: slice


@dataclass(frozen=True)
class Space:
    """Cycles as points.

    Attributes:
        ids: of the cycles, in order of time; ``rows``: their columns that people read, by name.
        points: (n, d), weighted: the sum of the absolute differences of two rows is their distance, but for sentences.
        parts: what the columns of ``points`` are of.
        sentence: (n,) number of each cycle's sentence. ``sentences``: (k, k) weighted distances between them.
        grouping: (d,) what each column of ``points`` is multiplied by to group failures; ``grouping_sentences``: the
            same of ``sentences``.
    """

    ids: tuple[str, ...]
    rows: tuple[dict[str, Any], ...]
    points: Array
    parts: tuple[Part, ...]
    sentence: Labels
    sentences: Array
    grouping: Array
    grouping_sentences: float

    def distances(self, of: Sequence[int] | Labels, to: Sequence[int] | Labels) -> Array:
        """Distances (len(of), len(to)) in 0..1 between cycles by their number."""
        return self._measured(self.points, self.sentences, np.asarray(of, np.intp), np.asarray(to, np.intp))

    def failures_apart(self, of: Sequence[int] | Labels, to: Sequence[int] | Labels) -> Array:
        """As `distances`, by the weights of `GROUPING`."""
        sentences = self.sentences * np.float32(self.grouping_sentences)
        return self._measured(self.points * self.grouping, sentences, np.asarray(of, np.intp), np.asarray(to, np.intp))

    def _measured(self, points: Array, sentences: Array, of: Labels, to: Labels) -> Array:
        apart = cdist(points[of], points[to], "cityblock")
        return np.asarray(apart + sentences[np.ix_(self.sentence[of], self.sentence[to])], np.float32)

    def by_family(self, one: int, other: int) -> dict[str, float]:
        """Return how far two cycles are apart in each family: 0..1 of what it can be."""
        found = dict.fromkeys(FAMILIES, 0.0)
        apart = np.abs(self.points[one] - self.points[other])
        for part in self.parts:
            found[part.family] += float(apart[part.columns].sum())
        found["how it ended"] += float(self.sentences[self.sentence[one], self.sentence[other]])
        return {family: value / FAMILIES[family][0] for family, value in found.items()}


SHOWN = ("cycle_id", "started_ns", "result", "code", "object", "reason", "failed_stage", "file", "label")


def space(catalogue: Catalogue) -> Space:
    """All cycles of a catalogue that ended, as points. Raises: CatalogueError."""
    features = [feature for _, some in FAMILIES.values() for feature in some]
    names = list(dict.fromkeys([*SHOWN, *(feature.column for feature in features)]))
    where, given = catalogue.where()
    sql = f"SELECT {', '.join(names)} FROM cycles WHERE {where} AND result IN ('SUCCESS', 'FAILED', 'ABORTED', 'EMPTY')"
    found = list(catalogue.rows(f"{sql} ORDER BY started_ns, cycle_id", given))
    return space_of({name: [row[index] for row in found] for index, name in enumerate(names)})


def space_of(columns: dict[str, list[Any]]) -> Space:
    """As `space`, of the catalogue's columns by name, each with a value a cycle; None = missing."""
    count = len(columns["cycle_id"])
    blocks, factors, parts = list[Array](), list[Array](), list[Part]()
    sentence, sentences, grouping_sentences = np.zeros(count, np.intp), np.zeros((1, 1), np.float32), 1.0
    at = 0
    for family, feature, weight, in_groups in _weighted():
        values = columns[feature.column]
        if feature.kind == "sentence":
            sentence, apart = _sentences(values)
            sentences, grouping_sentences = apart * np.float32(weight), in_groups / weight
            continue
        block = _BLOCKS[feature.kind](feature.column, values)
        factor = np.full(block.shape[1], in_groups / weight, np.float32)
        factor[_says_there(feature, block)] = 0.0
        blocks.append(block * np.float32(weight))
        factors.append(factor)
        parts.append(Part(feature.column, family, slice(at, at + block.shape[1])))
        at += block.shape[1]
    points = np.concatenate(blocks, axis=1) if count else np.empty((0, at), np.float32)
    rows = tuple({name: columns[name][index] for name in SHOWN} for index in range(count))
    return Space(
        tuple(columns["cycle_id"]), rows, points, tuple(parts), sentence, sentences,
        np.concatenate(factors), grouping_sentences,
    )  # fmt: skip


def _weighted() -> Iterator[tuple[str, Feature, float, float]]:
    """Each feature with its family, its weight in a distance, and that in a distance of failures."""
    for family, (weight, features) in FAMILIES.items():
        shares = sum(feature.share for feature in features)
        in_groups = sum(feature.share for feature in features if not feature.is_when)
        for feature in features:
            grouping = 0.0 if feature.is_when else GROUPING[family] * feature.share / in_groups
            yield family, feature, weight * feature.share / shares, grouping


def _says_there(feature: Feature, block: Array) -> slice:
    """The columns of a feature's block that only say whether it has a value."""
    return slice(1, block.shape[1], 2) if feature.kind in ("number", "values") else slice(0, 0)


# --- one column -------------------------------------------------------------------------------------------------------


def _number(name: str, values: Sequence[Any]) -> Array:
    """Two columns: whether there is a value, and where it lies between the extremes; each is half of it."""
    raw = np.array([np.nan if value is None else float(value) for value in values])
    is_there = np.isfinite(raw)
    scaled = np.full(len(raw), 0.5)
    if is_there.any():
        low, middle, high = np.percentile(raw[is_there], [25, 50, 75])
        spread = max((high - low) / 1.349, _FLOOR.get(_UNITS.get(name, ""), 0.05))
        scaled[is_there] = 0.5 + np.clip((raw[is_there] - middle) / spread, -_REACH, _REACH) / (2 * _REACH)
    return np.stack([scaled / 2, is_there / 2], axis=1).astype(np.float32)


def _word(_name: str, values: Sequence[Any]) -> Array:
    known = {value: index for index, value in enumerate(sorted({value or "" for value in values}))}
    block = np.zeros((len(values), len(known)), np.float32)
    block[np.arange(len(values)), [known[value or ""] for value in values]] = 0.5
    return block


def _part(_name: str, values: Sequence[Any]) -> Array:
    """The part of the cell that a sentence speaks of first; "" for none of them."""
    found = [_PART.search(_plain(value)) for value in values]
    return _word("", [one[0] if one is not None else "" for one in found])


def _plain(sentence: str | None) -> str:
    """The first sentence in small letters, without its numbers and without names in quotes."""
    first = _FIRST.split(sentence or "", maxsplit=1)[0]
    return _NUMBER.sub("#", _QUOTED.sub("'", first)).lower()


def _counts(_name: str, values: Sequence[Any]) -> Array:
    """Shares of each key, halved: two cycles with nothing in common are 1 apart, one of them without any 0.5."""
    loaded = [_loaded(value) for value in values]
    known = {key: index for index, key in enumerate(sorted({key for one in loaded for key in one}))}
    block = np.zeros((len(values), len(known)), np.float32)
    for row, one in enumerate(loaded):
        total = 2 * sum(one.values())
        for key, value in one.items():
            block[row, known[key]] = value / total if total else 0.0
    return block


def _values(_name: str, values: Sequence[Any]) -> Array:
    loaded = [_loaded(value) for value in values]
    keys = sorted({key for one in loaded for key in one})
    if not keys:
        return np.zeros((len(values), 0), np.float32)
    blocks = [_number("", [one.get(key) for one in loaded]) for key in keys]
    return np.concatenate(blocks, axis=1) / np.float32(len(keys))


_BLOCKS = {"number": _number, "word": _word, "counts": _counts, "values": _values, "part": _part}


@cache
def _loaded(value: str | None) -> dict[str, float]:
    """A JSON object of numbers, or a list of words that are counted; empty for anything else."""
    try:
        found = json.loads(value) if isinstance(value, str) else None
    except ValueError:
        return {}
    if isinstance(found, list):
        return {str(word): float(found.count(word)) for word in found if isinstance(word, str)}
    if not isinstance(found, dict):
        return {}
    return {key: float(number) for key, number in found.items() if isinstance(number, int | float)}


def _sentences(values: Sequence[Any]) -> tuple[Labels, Array]:
    """The number of each plain sentence, and the share of their words that two of them do not have both."""
    plain = [_plain(value) for value in values]
    known = {text: index for index, text in enumerate(sorted(set(plain)))}
    words = [set(_WORD.findall(text)) for text in known]
    places = {word: index for index, word in enumerate(sorted(set().union(*words)))}
    has = np.zeros((len(words), max(1, len(places))), np.float32)
    for row, some in enumerate(words):
        has[row, [places[word] for word in some]] = 1.0
    shared, sizes = has @ has.T, has.sum(axis=1)
    either = sizes[:, None] + sizes[None, :] - shared
    apart = 1.0 - np.divide(shared, either, out=np.ones_like(shared), where=either > 0)
    return np.array([known[text] for text in plain], np.intp), apart.astype(np.float32)
