"""The role of the goal-image model: the three calls of the paper's stage 1, and locating the target."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from perception.observed_object import Answer, ObservedObject


class GoalImageModel(Protocol):
    """Imagines the rod. A call without a usable answer raises CycleFailure.

    After a stop (``cancel``) no call that costs money begins, and none is waited for: CycleFailure(STOPPED).

    Attributes:
        name: recorded with every reply.
        is_hosted: its calls cost money or minutes; it is asked about the next object only when one fails.
    """

    name: str
    is_hosted: bool

    def begin(self) -> None:
        """Begin a cycle; its cost is counted from zero."""

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        """Return the place of the target in the whole image (H, W, 3), as text in the form that the prompt asks for."""

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Place and direction of a grasp, as text (R of the paper)."""

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """One self-contained editing instruction (T2); the prompt contains the reasoning."""

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Return the goal image (I_G): the same object, pierced by the rod."""

    def close(self) -> None:
        """Release connections; no call follows."""
