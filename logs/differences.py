"""Compares two messages field by field, in the units that people use.

NaN equals NaN. Text, numbers without tolerance, enums and booleans must be equal; poses differ in mm and degrees;
images by the number of differing pixels.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.codec import Json
from bus.frozen import Message
from bus.transforms import angle_between_rad

Array = npt.NDArray[Any]
POSE = "mm|deg"
_UNIT_BY_SUFFIX = {
    "px": "px",
    "m": "m",
    "rad": "rad",
    "deg": "deg",
    "n": "N",
    "s": "s",
    "nm": "Nm",
    "ns": "ns",
    "m2": "m2",
}
_IGNORED = {"latency_s", "took_s"}
"""Fields that depend on the machine, not on the stage."""


_NEWER = {("Rejection", "obstacle")}
"""Fields that older recordings lack."""


@dataclass(frozen=True)
class Tolerance:
    """The allowed difference of a value.

    Attributes:
        value: in ``unit``. For a pose (`POSE`): mm and degrees.
        unit: one of `_UNIT_BY_SUFFIX`, `POSE` or "".
    """

    value: float
    unit: str


@dataclass(frozen=True)
class Difference:
    """One field that differs.

    Attributes:
        field: dotted path. ``recorded``, ``replayed``: both values.
        difference, tolerance: in ``unit``; ``difference`` is None where there is no number, e.g. for text or NaN.
        unit: e.g. "m", "mm", "deg" or "px"; "" for none.
    """

    field: str
    recorded: object
    replayed: object
    difference: float | None
    tolerance: float
    unit: str

    def to_json(self) -> Json:
        """Return the fields as a JSON object."""
        return asdict(self)

    def describe(self) -> str:
        """One line for a person."""
        values = f"{self.field}: {_short(self.recorded)} -> {_short(self.replayed)} {self.unit}".rstrip()
        return values if self.difference is None else f"{values} (by {self.difference:.4g}, allowed {self.tolerance:g})"


def compare(recorded: Message, replayed: Message, tolerances: Mapping[str, Tolerance]) -> list[Difference]:
    """All differences between two messages, in the order of their fields.

    Args:
        tolerances: field pattern -> tolerance; ``*`` matches any text, so ``a[*].b`` is field b of any a. The first
            matching pattern counts; without one the values must be equal.
    """
    rules = [(re.compile(re.escape(pattern).replace(r"\*", ".*")), rule) for pattern, rule in tolerances.items()]

    def tolerance(path: str) -> Tolerance:
        for pattern, rule in rules:
            if pattern.fullmatch(path):
                return rule
        return Tolerance(0.0, unit_of(path))

    if type(recorded) is not type(replayed):
        return [_plain("type", type(recorded).__name__, type(replayed).__name__)]
    return [
        found for path, a, b in leaves("", recorded, replayed) for found in _compare_leaf(path, a, b, tolerance(path))
    ]


def unit_of(path: str) -> str:
    """Return the unit at the end of a field's name, or ""."""
    name = re.sub(r"\[\d+\]", "", path).rpartition(".")[2]
    return _UNIT_BY_SUFFIX.get(name.rpartition("_")[2], "") if "_" in name else ""


def leaves(path: str, a: object, b: object) -> Iterator[tuple[str, object, object]]:
    """Pairs of values without parts, with their path; a differing count ends its branch."""
    if isinstance(a, Message) and type(a) is type(b):
        for name in type(a).model_fields:
            if name not in _IGNORED and not _is_newer(a, name):
                yield from leaves(f"{path}.{name}" if path else name, getattr(a, name), getattr(b, name))
    elif isinstance(a, dict) and isinstance(b, dict) and list(a) == list(b):
        for name in a:
            yield from leaves(f"{path}.{name}", a[name], b[name])
    elif isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        for index, (one, other) in enumerate(zip(a, b, strict=True)):
            yield from leaves(f"{path}[{index}]", one, other)
    elif isinstance(a, tuple) and isinstance(b, tuple):
        yield f"{path}.count", len(a), len(b)
    else:
        yield path, a, b


def _is_newer(recorded: Message, name: str) -> bool:
    """Whether a field came after the recording was made, which says nothing of it."""
    return (type(recorded).__name__, name) in _NEWER and name not in recorded.model_fields_set


def _compare_leaf(path: str, a: object, b: object, rule: Tolerance) -> list[Difference]:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return _compare_arrays(path, a, b, rule)
    if isinstance(a, float) and isinstance(b, float):
        if a == b or (math.isnan(a) and math.isnan(b)) or abs(a - b) <= rule.value:
            return []
        return [Difference(path, _number(a), _number(b), _finite(abs(a - b)), rule.value, rule.unit)]
    return [] if a == b and type(a) is type(b) else [_plain(path, _value(a), _value(b), rule.unit)]


def _compare_arrays(path: str, a: Array, b: Array, rule: Tolerance) -> list[Difference]:
    if a.shape != b.shape:
        shape = _plain(f"{path}.shape", list(a.shape), list(b.shape))
        common = min(len(a), len(b))  # for two trajectories: the samples that both have
        is_series = rule.value > 0 and a.shape[1:] == b.shape[1:] and common > 0
        return [shape, *(_compare_arrays(path, a[:common], b[:common], rule) if is_series else [])]
    if a.dtype in (np.uint8, np.bool_):
        differing = int((a != b).reshape(*a.shape[:2], -1).any(axis=-1).sum())
        allowed = rule.value if rule.unit == "px" else 0.0
        return [Difference(path, 0, differing, float(differing), allowed, "px")] if differing > allowed else []
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    if same.all():
        return []
    if rule.unit == POSE:
        return _compare_poses(path, a, b, rule)
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        deviation = np.where(same, 0.0, np.abs(np.asarray(a, float) - b))
    deviation = np.nan_to_num(deviation, nan=np.inf, posinf=np.inf)
    if float(deviation.max()) <= rule.value:
        return []
    where = np.unravel_index(int(deviation.argmax()), a.shape)
    label = f"{path}[{','.join(str(int(index)) for index in where)}]"
    return [Difference(label, _number(a[where]), _number(b[where]), _finite(deviation[where]), rule.value, rule.unit)]


def _compare_poses(path: str, a: Array, b: Array, rule: Tolerance) -> list[Difference]:
    found = []
    moved_mm = float(np.linalg.norm(a[:3, 3] - b[:3, 3])) * 1e3
    if not moved_mm <= rule.value:
        before_mm, after_mm = ([_number(round(float(value) * 1e3, 4)) for value in pose[:3, 3]] for pose in (a, b))
        found.append(Difference(f"{path}.translation", before_mm, after_mm, _finite(moved_mm), rule.value, "mm"))
    turned_deg = math.degrees(angle_between_rad(a, b))
    if not turned_deg <= rule.value:
        found.append(Difference(f"{path}.rotation", 0.0, _number(turned_deg), _finite(turned_deg), rule.value, "deg"))
    return found


def _plain(path: str, recorded: object, replayed: object, unit: str = "") -> Difference:
    return Difference(path, recorded, replayed, None, 0.0, unit)


def _number(value: float) -> float | str:
    """A float that JSON can hold; NaN and infinity as text."""
    number = float(value)
    return number if math.isfinite(number) else str(number)


def _finite(value: float) -> float | None:
    """A difference, or None when it is not finite (NaN against a number)."""
    return float(value) if math.isfinite(value) else None


def _value(value: object) -> object:
    if isinstance(value, float):
        return _number(value)
    return value if value is None or isinstance(value, (str, int, bool)) else str(value)


def _short(value: object) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 80 else text[:77] + "..."
