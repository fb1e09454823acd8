"""The type of a column, and what its value is taken from."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeVar

from bus.messages import Delivery, Detections, Execution, Grasp, ObservedScene, PickPlan, Verdict
from logs.mcap.reader import CycleRecord, Stage
from logs.mcap.unseen_scene import is_made_up

Value = str | int | float | None
ResultT = TypeVar("ResultT")
_MAX_INTEGER = 2**63 - 1


@dataclass(frozen=True)
class Told:
    """One recorded cycle, as `logs.mcap.reader.read_stages` gives it, with the results of its stages."""

    record: CycleRecord

    @cached_property
    def runs(self) -> tuple[Stage, ...]:
        """The records of all stages, those of earlier looks too."""
        return (*self.record.superseded, *self.record.stages.values())

    @cached_property
    def detections(self) -> Detections | None:
        """The result of detect; None without one, as below."""
        return self._result("detect", Detections)

    @cached_property
    def scene(self) -> ObservedScene | None:
        """The scene that detect saw last, also where it failed; None in recordings of before it was kept."""
        scene = self.record.scene
        return None if scene is None or is_made_up(scene) else scene

    @cached_property
    def plan(self) -> PickPlan | None:
        """The result of plan."""
        return self._result("plan", PickPlan)

    @cached_property
    def execution(self) -> Execution | None:
        """The result of execute."""
        return self._result("execute", Execution)

    @cached_property
    def verdict(self) -> Verdict | None:
        """The result of verify."""
        return self._result("verify", Verdict)

    @cached_property
    def delivery(self) -> Delivery | None:
        """The result of deliver."""
        return self._result("deliver", Delivery)

    @cached_property
    def chosen(self) -> Grasp | None:
        """The grasp that plan chose."""
        if self.plan is None or self.detections is None or not 0 <= self.plan.grasp < len(self.detections.grasps):
            return None
        return self.detections.grasps[self.plan.grasp]

    def _result(self, stage: str, kind: type[ResultT]) -> ResultT | None:
        found = self.record.stages.get(stage)
        return found.result if found is not None and isinstance(found.result, kind) else None


class Column(NamedTuple):
    """One column of the catalogue.

    Attributes:
        type: SQLite's. ``unit``: of the value, "" for none.
        meaning: one sentence, for the page. ``take``: takes the value from a cycle; None becomes NULL.
    """

    name: str
    type: Literal["TEXT", "INTEGER", "REAL"]
    unit: str
    meaning: str
    take: Callable[[Told], Value]


def stored(value: Value) -> Value:
    """Return the value as SQLite can hold it: no NaN, no integer beyond 64 bits, no text that is not UTF-8."""
    match value:
        case bool():
            return int(value)
        case int():
            return value if abs(value) <= _MAX_INTEGER else None
        case float():
            return float(value) if math.isfinite(value) else None
        case str():
            return value.encode("utf-8", "replace").decode()
    return None


def packed(values: Mapping[str, object]) -> str | None:
    """A JSON object with its keys in order; None for an empty one."""
    return json.dumps(dict(sorted(values.items()))) if values else None


def attribute(part: str, name: str) -> Callable[[Told], Value]:
    """An attribute of the result of one stage, or of the chosen grasp; None without it."""

    def take(told: Told) -> Value:
        found = getattr(told, part)
        value: Value = getattr(found, name) if found is not None else None
        return value

    return take
