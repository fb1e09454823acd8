"""Stage 2, detect: VLAD-Grasp (`perception.detector`). Pure."""

from __future__ import annotations

from bus.messages import Detections, Observation
from config.schema import Station
from perception.detector import detect as vlad_grasp


def detect(observation: Observation, station: Station) -> Detections:
    """Ranked grasps and their evidence. Raises: CycleFailure (NO_OBJECT, NO_GRASP, MODEL_*)."""
    return vlad_grasp(observation, station)
