"""The detectors that are measured, by name. The only module here that knows perception."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bus.messages import Grasp, Observation
from config.schema import Station
from perception.detector import detect, ignore_reply
from perception.models import Models, open_models

Detect = Callable[[Observation, Station], Sequence[Grasp]]
"""The ranked grasps of an observation, the best first. Raises: CycleFailure for none."""


class Product:
    """The product's `detect`, with the models of the station."""

    def __init__(self) -> None:
        self._models: dict[int, tuple[Station, Models]] = {}

    def __call__(self, observation: Observation, station: Station) -> Sequence[Grasp]:
        """Detect. Raises: CycleFailure."""
        _, models = self._models.setdefault(id(station), (station, open_models(station, {})))
        return detect(observation, station, models, ignore_reply).grasps
