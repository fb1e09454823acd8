"""The detectors that are measured, by name, and when they look again. The only module here that knows perception."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from bus.messages import Grasp, Observation
from config.schema import Station
from perception.detector import detect, ignore_reply
from perception.models import Models, open_models


class Found(Protocol):
    """The result of a detector."""

    @property
    def grasps(self) -> Sequence[Grasp]:
        """Ranked, the best first; at least one."""


Detect = Callable[[Sequence[Observation], Station], Found]
"""Detects in one or more observations of a scene, the first from above. Raises: CycleFailure for no grasp."""
WhyLookAgain = Callable[[Any, int, Station], str]
"""Why an outcome (what a detector returns, or a CycleFailure) after so many looks calls for a further one, or ""."""


class Product:
    """The product's `detect`, with the models of the station."""

    def __init__(self) -> None:
        self._models: dict[int, tuple[Station, Models]] = {}

    def __call__(self, observations: Sequence[Observation], station: Station) -> Found:
        """Detect. Raises: CycleFailure."""
        _, models = self._models.setdefault(id(station), (station, open_models(station, {})))
        first, *others = observations
        return detect(first, station, models, ignore_reply, others=others)
