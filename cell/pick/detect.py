"""Stage 2, detect: VLAD-Grasp (`perception.detector`). Pure, given what the models answer."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, ModelReply, Observation
from bus.threads import OwnedThread, Role
from config.schema import Station
from perception.detector import detect as vlad_grasp
from perception.detector import ignore_reply
from perception.goal.imagine import OnReply
from perception.models import Models

_Outcome = queue.SimpleQueue[Detections | BaseException]
_LOOK_S = 0.02
_GRACE_S = 0.3
"""A stop waits so long for the detection to end by itself: it then has said which call it gave up."""


def detect(
    observation: Observation,
    station: Station,
    models: Models,
    on_reply: OnReply = ignore_reply,
    cancel: Cancel | None = None,
) -> Detections:
    """Ranked grasps and their evidence. Raises: CycleFailure (NO_OBJECT, NO_GRASP, MODEL_*, SPEND_LIMIT, STOPPED)."""
    return vlad_grasp(observation, station, models, on_reply, cancel)


def detect_unless_halted(
    observation: Observation,
    station: Station,
    models: Models,
    on_reply: OnReply,
    halted: Callable[[], bool],
) -> Detections:
    """`detect`, given up at once on a stop: a hosted model may take minutes, and nothing can call it back.

    After it no further call begins, and the one under way is said as given up. A computation that is left behind ends
    at its next look at the stop; it says nothing any more. Raises: CycleFailure(STOPPED).
    """
    outcome: _Outcome = queue.SimpleQueue()
    cancel, replies = Cancel(), _ReplyGate(on_reply)

    def work() -> None:
        try:
            outcome.put(detect(observation, station, models, replies.on_reply, cancel))
        except BaseException as error:  # noqa: BLE001 - handed over to the waiting thread, which raises it
            outcome.put(error)

    OwnedThread(Role.DETECT, work).start()
    result = _awaited(outcome, cancel, halted)
    if cancel.is_set and (result is None or isinstance(result, (Detections, CycleFailure))):
        replies.close()
        raise CycleFailure(Code.STOPPED, "Stopped during 'detect'.")
    if isinstance(result, BaseException):
        raise result
    assert result is not None, "only a stop ends the wait without an outcome"
    return result


def _awaited(outcome: _Outcome, cancel: Cancel, halted: Callable[[], bool]) -> Detections | BaseException | None:
    """How the detection ended; None when a stop came - ``cancel`` is then set - and it did not end soon."""
    while not cancel.is_set:
        try:
            return outcome.get(timeout=_LOOK_S)
        except queue.Empty:
            if halted():
                cancel.set()
    try:
        return outcome.get(timeout=_GRACE_S)
    except queue.Empty:
        return None


class _ReplyGate:
    """Says what it is given, until it is shut: nothing comes out in the next cycle's time."""

    def __init__(self, on_reply: OnReply) -> None:
        self._on_reply, self._turn, self._is_closed = on_reply, threading.Lock(), False

    def on_reply(self, reply: ModelReply) -> None:
        with self._turn:
            if not self._is_closed:
                self._on_reply(reply)

    def close(self) -> None:
        with self._turn:
            self._is_closed = True
