"""Stage 2, detect: VLAD-Grasp (`perception.detector`). Pure."""

from __future__ import annotations

from bus.messages import Detections, Observation
from config.schema import Station
from perception import detector


def detect(observation: Observation, station: Station) -> Detections:
    """Ranked grasps and their evidence. Raises: CycleFailure (NO_OBJECT, NO_GRASP, MODEL_*)."""
    return detector.detect(observation, station)
