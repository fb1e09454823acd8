"""Another package's goal-image model: every call has a deadline, and its answer is checked."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.codes import Code
from perception.models.base import GoalImageModel
from perception.models.checked_answer import checked_picture, checked_words
from perception.models.plug_in_calls import PlugInCalls, Rules
from perception.observed_object import Answer, ObservedObject

_MAY_SAY = frozenset(
    {
        *(code for code in Code if code.startswith("MODEL_")),
        Code.SPEND_LIMIT,
        Code.NO_GRASP,
        Code.NO_DEPTH,
        Code.NOT_SEEN,
        Code.TARGET_NOT_FOUND,
        Code.STOPPED,
    }
)
"""Codes that a model may end a cycle with by itself; of others some abort the cell."""


class PlugInModel:
    """Asks one goal-image model, which runs once at a time.

    Args:
        name: as the station names it. ``package``: that brings it, with its version; "" = unknown.
        deadline_s: of a call; None = none, and on the caller's thread.
    """

    def __init__(self, model: GoalImageModel, name: str, package: str, deadline_s: float | None) -> None:
        self.name, self.is_hosted = model.name, bool(model.is_hosted)
        self._model = model
        whose = f"The goal-image model {name!r} of package {package.partition(' ')[0] or 'unknown'}"
        self._rules = Rules(whose, Code.MODEL_FAILED, Code.MODEL_TIMEOUT, _MAY_SAY, package)
        self._calls = PlugInCalls(self._rules, deadline_s)

    def begin(self) -> None:
        """Begin a cycle of the model. Raises: CycleFailure, as `PlugInCalls.ask`."""
        self._calls.ask(lambda _: self._model.begin(), Cancel())

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        """As the model. Raises: CycleFailure, as `PlugInCalls.ask`; MODEL_FAILED for what is no answer."""
        given = self._calls.ask(lambda stop: self._model.locate(color, prompt, stop), cancel)
        return checked_words(self._rules, "locate", given)

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """As the model. Raises: as `locate`."""
        given = self._calls.ask(lambda stop: self._model.reason(observed_object, prompt, stop), cancel)
        return checked_words(self._rules, "reason", given)

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """As the model. Raises: as `locate`."""
        given = self._calls.ask(lambda stop: self._model.direct(observed_object, prompt, stop), cancel)
        return checked_words(self._rules, "direct", given)

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """As the model. Raises: as `locate`."""
        given = self._calls.ask(lambda stop: self._model.render(observed_object, prompt, stop), cancel)
        return checked_picture(self._rules, given, observed_object)

    def close(self) -> None:
        """Close the model; one that is still busy is left behind."""
        self._calls.close(self._model.close)
