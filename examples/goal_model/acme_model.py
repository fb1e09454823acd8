"""A goal-image model of another package: it lays the rod across the object's narrow side, and paints it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.transforms import apply
from config.schema import Station
from perception.geometry.lift import lift
from perception.models.painter import paint
from perception.observed_object import Answer, ObservedObject


class RodSettings(BaseModel):
    """`[perception.settings]` of the station.

    Attributes:
        height: of the rod, as a share of the object's. ``length_m``: of the rod.
    """

    model_config = ConfigDict(extra="forbid")
    height: float = Field(default=0.5, gt=0, lt=1)
    length_m: float = Field(default=0.16, gt=0, le=0.3)


class Crosswise:
    """The three steps of the paper's stage 1. ``name`` stands in every recorded reply."""

    Settings = RodSettings
    name = "acme"
    is_hosted = False  # its calls cost nothing

    def __init__(self, station: Station, settings: RodSettings) -> None:
        self._settings = settings
        self._radius_m = station.perception.rod_radius_m

    def begin(self) -> None:
        """A new cycle."""

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        raise CycleFailure(Code.TARGET_NOT_FOUND, "This model understands no words: name the target by its pixel.")

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        return Answer("Grasp it across its narrow side.")

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        return Answer("Draw a straight rod across the narrow side, through the middle.")

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Across the object, at the height that is set; ``goal`` is the observed image with the rod painted into it."""
        rgbd = observed_object.rgbd
        points = apply(observed_object.base_from_color, lift(observed_object.mask, rgbd.depth_m, rgbd.camera))
        level_m = max(points[:, 2].max() * self._settings.height, 2 * self._radius_m)  # the table is z = 0 of base
        middle = np.append(np.median(points[:, :2], axis=0), level_m)
        narrow = np.linalg.eigh(np.cov(points[:, :2].T))[1][:, 0]
        half_m = self._settings.length_m / 2
        ends_base = middle + np.outer([-half_m, half_m], np.append(narrow, 0.0))
        base_from_color = observed_object.base_from_color
        ends = (ends_base - base_from_color[:3, 3]) @ base_from_color[:3, :3]
        return Answer("painted", goal=paint(observed_object, ends, self._radius_m))

    def close(self) -> None:
        """It holds nothing."""
