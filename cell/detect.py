"""Stage 2, detect: VLAD-Grasp (`perception.detector`). Pure, given what the models answer."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, ModelReply, Observation
from config.schema import Station
from perception.detector import detect as vlad_grasp
from perception.detector import unsaid
from perception.imagine import Say
from perception.models import Models

_LOOK_S = 0.05


def detect(observation: Observation, station: Station, models: Models, say: Say = unsaid) -> Detections:
    """Ranked grasps and their evidence. Raises: CycleFailure (NO_OBJECT, NO_GRASP, MODEL_*, SPEND_LIMIT)."""
    return vlad_grasp(observation, station, models, say)


def detect_unless_halted(
    observation: Observation,
    station: Station,
    models: Models,
    say: Say,
    halted: Callable[[], bool],
) -> Detections:
    """`detect`, given up at once on a stop: a hosted model may take minutes, and nothing can call it back.

    What is given up ends by itself within its deadline; it says nothing any more. Raises: CycleFailure(STOPPED).
    """
    outcome: queue.SimpleQueue[Detections | BaseException] = queue.SimpleQueue()
    given_up = threading.Event()

    def say_unless_given_up(reply: ModelReply) -> None:
        if not given_up.is_set():
            say(reply)

    def work() -> None:
        try:
            outcome.put(detect(observation, station, models, say_unless_given_up))
        except BaseException as error:  # noqa: BLE001 - handed over to the waiting thread, which raises it
            outcome.put(error)

    threading.Thread(target=work, name="detect", daemon=True).start()
    while True:
        try:
            result = outcome.get(timeout=_LOOK_S)
        except queue.Empty:
            if halted():
                given_up.set()
                raise CycleFailure(Code.STOPPED, "Stopped during 'detect'.") from None
            continue
        if isinstance(result, BaseException):
            raise result
        return result
