"""The detectors that are measured, by name, and when they look again. The only module here that knows perception."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from inspect import signature
from typing import Any, Protocol

from bus.errors import CycleFailure
from bus.messages import Grasp, Observation
from config.schema import Station
from perception.detector import detect, ignore_reply
from perception.models import Models, open_models

_RULE = "cell.pick.looking"


class Found(Protocol):
    """What a detector returns."""

    @property
    def grasps(self) -> Sequence[Grasp]:
        """Ranked, the best first; at least one."""


Detect = Callable[[Sequence[Observation], Station], Found]
"""Detects in one or more observations of a scene, the first from above. Raises: CycleFailure for no grasp."""
WhyLookAgain = Callable[[Found | CycleFailure, int, Station], str]
"""Why an outcome after so many looks calls for a further one; "" = it does not."""


class Product:
    """The product's `detect`, with the models of the station."""

    def __init__(self) -> None:
        self._models: dict[int, tuple[Station, Models]] = {}

    def __call__(self, observations: Sequence[Observation], station: Station) -> Found:
        """Detect. Raises: CycleFailure."""
        _, models = self._models.setdefault(id(station), (station, open_models(station, {})))
        first, *others = observations
        more: dict[str, Any] = {"others": tuple(others)} if others else {}
        return detect(first, station, models, ignore_reply, **more)


def sees_several() -> bool:
    """Whether the product's `detect` takes several observations, and the cell has a rule for further looks."""
    return "others" in signature(detect).parameters and find_spec(_RULE) is not None


def why_look_again(outcome: Found | CycleFailure, looks: int, station: Station) -> str:
    """Ask the cell's own rule."""
    return str(import_module(_RULE).why_look_again(outcome, looks, station))
