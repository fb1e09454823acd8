"""Stage 2, detect: VLAD-Grasp (`perception.detector`). Pure, given the models' replies."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence

from bus.arrays import Vector3
from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, ModelReply, Observation
from bus.threads import OwnedThread, Role
from config.schema import Station
from perception.detector import OnScene, ignore_reply
from perception.detector import detect as vlad_grasp
from perception.goal.imagine import OnReply
from perception.models import Models

_Outcome = queue.SimpleQueue[Detections | BaseException]
_LOOK_S = 0.02
_GRACE_S = 0.3
"""Time that a stop waits for the detection to end by itself, so that it records the call it gave up."""


def detect(
    looks: Sequence[Observation],
    station: Station,
    models: Models,
    on_reply: OnReply = ignore_reply,
    cancel: Cancel | None = None,
    on_scene: OnScene | None = None,
    is_again: bool = False,
    failed_at: Sequence[Vector3] = (),
) -> Detections:
    """Ranked grasps and their evidence.

    Args:
        looks: the observations of the scene, the first from the capture pose.
        on_reply: called with the record of every call to the goal-image model. ``cancel``: a stop request.
        on_scene: called with what was seen. ``is_again``: the cycle has detected before, in fewer looks.
        failed_at: (3,) places in ``base`` where picks failed: the things there are no targets.

    Raises: CycleFailure, as `perception.detector.detect`.
    """
    return vlad_grasp(looks[0], station, models, on_reply, cancel, on_scene, looks[1:], is_again, failed_at)


def detect_unless_halted(
    looks: Sequence[Observation],
    station: Station,
    models: Models,
    on_reply: OnReply,
    halted: Callable[[], bool],
    on_scene: OnScene | None = None,
    is_again: bool = False,
    failed_at: Sequence[Vector3] = (),
) -> Detections:
    """`detect`, abandoned immediately on a stop: a hosted model may take minutes, and its call cannot be cancelled.

    After a stop no further call begins, and the one under way is recorded as given up. An abandoned computation ends at
    its next check of the stop, and publishes nothing any more.

    Raises: CycleFailure, as `detect`; STOPPED.
    """
    outcome: _Outcome = queue.SimpleQueue()
    cancel, replies = Cancel(), _ReplyGate(on_reply)

    def work() -> None:
        try:
            outcome.put(detect(looks, station, models, replies.on_reply, cancel, on_scene, is_again, failed_at))
        except BaseException as error:  # noqa: BLE001 - handed to the waiting thread, which raises it
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
    """The outcome of the detection; None after a stop (``cancel`` is then set) if it does not end soon."""
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
    """Forwards replies until it is closed, so that none is published during the next cycle."""

    def __init__(self, on_reply: OnReply) -> None:
        self._on_reply, self._turn, self._is_closed = on_reply, threading.Lock(), False

    def on_reply(self, reply: ModelReply) -> None:
        with self._turn:
            if not self._is_closed:
                self._on_reply(reply)

    def close(self) -> None:
        with self._turn:
            self._is_closed = True
