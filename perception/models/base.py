"""The role of the goal-image model: three calls, as in the paper's stage 1."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from perception.subject import Answer, ObservedObject


class GoalImageModel(Protocol):
    """Imagines the rod. ``name`` is recorded with every reply. A call without answer raises CycleFailure.

    After a stop (``cancel``) no call begins that costs something, and none is waited for: CycleFailure(STOPPED).
    """

    name: str

    def begin(self) -> None:
        """A new cycle: its spending counts from zero."""

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        """Where something is in the whole image, in words as the prompt asks for them."""

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Where and how the object can be grasped, in words (R of the paper)."""

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """One precise, self-contained editing instruction (T2); the prompt holds the reasoning."""

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """The goal image (I_G): the same object, impaled by the rod."""

    def close(self) -> None:
        """Let go of connections; nothing is asked after it."""
