"""Settings of the faults that may be set on demand, to see what the cell does about them."""

from __future__ import annotations

from pydantic import model_validator

from bus.injection import PARTS, Fault
from config.base import Seconds, Settings


class FaultSettings(Settings):
    """Off by default: nothing is wrapped, and nobody answers ``fault/{part}``.

    Attributes:
        allowed: parts may be told to misbehave (`cell fault`). An arm that is ``wrong`` moves elsewhere than planned.
        camera, arm, hand, model, bus, disk: how each misbehaves from the start.
        delay_s: how late a slow one is.
    """

    allowed: bool = False
    camera: Fault = Fault.NONE
    arm: Fault = Fault.NONE
    hand: Fault = Fault.NONE
    model: Fault = Fault.NONE
    bus: Fault = Fault.NONE
    disk: Fault = Fault.NONE
    delay_s: Seconds = 1.0

    @model_validator(mode="after")
    def _none_unless_allowed(self) -> FaultSettings:
        if not self.allowed and any(getattr(self, part) is not Fault.NONE for part in PARTS):
            raise ValueError("a part may misbehave only where faults.allowed is true")
        return self
