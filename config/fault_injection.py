"""Settings of injected faults, which test the cell's reactions."""

from __future__ import annotations

from pydantic import model_validator

from bus.fault_injection import PARTS, Fault
from config.base import Seconds, Settings


class FaultSettings(Settings):
    """Off by default: no device is wrapped, and no process answers ``fault/{part}``.

    Attributes:
        allowed: parts accept injected faults (`cell fault`). An arm with ``wrong`` moves elsewhere than planned.
        camera, arm, hand, model, bus, disk: the fault of each from the start.
        delay_s: the delay of every answer under ``slow``.
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
