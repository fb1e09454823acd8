"""The models of a replay: they answer with the recorded replies."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from bus.cancel import Cancel
from bus.errors import CycleFailure, RecordingError
from bus.messages import ModelReply
from perception.models.base import GoalImageModel
from perception.observed_object import Answer


class RecordedModel:
    """Returns recorded replies in their order, step by step; recorded failures are raised again."""

    def __init__(self, replies: Iterable[ModelReply]) -> None:
        self._replies = list(replies)
        self._left: list[ModelReply] = []
        self.name, self.is_hosted = self._replies[0].model if self._replies else "", True

    def begin(self) -> None:
        """Do nothing; the replies of the recorded cycle are in order."""
        self._left = list(self._replies)

    def locate(self, color: Any, prompt: str, cancel: Cancel) -> Answer:
        """Return the next recorded reply of this step, or raise its failure. Raises: RecordingError after the last."""
        return self._next("locate")

    def reason(self, observed_object: Any, prompt: str, cancel: Cancel) -> Answer:
        """Return the next recorded reply of this step, or raise its failure. Raises: RecordingError after the last."""
        return self._next("reason")

    def direct(self, observed_object: Any, prompt: str, cancel: Cancel) -> Answer:
        """Return the next recorded reply of this step, or raise its failure. Raises: RecordingError after the last."""
        return self._next("direct")

    def render(self, observed_object: Any, prompt: str, cancel: Cancel) -> Answer:
        """Return the next recorded reply of this step, or raise its failure. Raises: RecordingError after the last."""
        return self._next("render")

    def close(self) -> None:
        """Do nothing; there are no resources."""

    def _next(self, step: str) -> Answer:
        """Raises: the recorded CycleFailure; RecordingError when no further reply was recorded."""
        reply = next((reply for reply in self._left if reply.step == step), None)
        if reply is None:
            raise RecordingError(
                f"The recording holds no further reply to the step {step!r} of a hosted model.",
                "Replay with the recorded settings of perception.model and perception.imagine.",
            )
        self._left.remove(reply)
        return _answer(reply)


class SpoiledModel:
    """An embedded model in the replay of a cycle with injected faults allowed (`perception.models.fault_injection`).

    A recorded failure is raised again, and a recorded picture is returned, because an embedded model's own is never
    recorded; every other answer is computed anew.
    """

    def __init__(self, model: GoalImageModel, replies: Iterable[ModelReply]) -> None:
        self._model, self._replies = model, list(replies)
        self._asked = 0
        self.name, self.is_hosted = model.name, model.is_hosted

    def begin(self) -> None:
        """Begin a cycle of the embedded model. Raises: CycleFailure: the recorded one, or the model's."""
        self._asked = 0
        if self._replies and self._replies[0].step == "begin":
            _answer(self._replies[0])
        self._model.begin()

    def locate(self, color: Any, prompt: str, cancel: Cancel) -> Answer:
        """Raise the recorded failure, or return the embedded model's answer. Raises: CycleFailure."""
        return self._ask(lambda: self._model.locate(color, prompt, cancel))

    def reason(self, observed_object: Any, prompt: str, cancel: Cancel) -> Answer:
        """Raise the recorded failure, or return the embedded model's answer. Raises: CycleFailure."""
        return self._ask(lambda: self._model.reason(observed_object, prompt, cancel))

    def direct(self, observed_object: Any, prompt: str, cancel: Cancel) -> Answer:
        """Raise the recorded failure, or return the embedded model's answer. Raises: CycleFailure."""
        return self._ask(lambda: self._model.direct(observed_object, prompt, cancel))

    def render(self, observed_object: Any, prompt: str, cancel: Cancel) -> Answer:
        """Return the recorded picture, or the embedded model's. Raises: CycleFailure, recorded or the model's."""
        return self._ask(lambda: self._model.render(observed_object, prompt, cancel))

    def close(self) -> None:
        """Close the embedded model."""
        self._model.close()

    def _ask(self, ask: Callable[[], Answer]) -> Answer:
        reply = self._replies[self._asked] if self._asked < len(self._replies) else None
        self._asked += 1
        spoiled = reply is not None and (reply.failure is not None or reply.image_png is not None)
        return _answer(reply) if reply is not None and spoiled else ask()


def _answer(reply: ModelReply) -> Answer:
    """Raises: the recorded CycleFailure."""
    if reply.failure is not None:
        raise CycleFailure(reply.failure, reply.text_of_failure)
    return Answer(reply.text, reply.image_png, usage=reply.usage, attempts=reply.attempts)
