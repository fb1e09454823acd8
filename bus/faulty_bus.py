"""Parts with injected faults: their base, a node's bus, and the answer to ``fault/{part}``.

This module, and those that wrap devices, the model and the disk, are imported only where the station allows faults:
by `cell.build` for the cell's own process, by `drivers.node` for a node's.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import zenoh

from bus import topics
from bus.answering import Answers
from bus.clock import WALL_CLOCK, DeadlineClock
from bus.codec import decode, encode
from bus.commands import Event, Nothing
from bus.errors import BadPayload
from bus.fault_injection import Fault, FaultRequest
from bus.frozen import Message
from bus.sample import Asked, Handler, Sample
from bus.session import Bus
from bus.topics import Topic, encoding_of

_ALWAYS_DONE = (topics.ARM_STOP, topics.ARM_HOLD, topics.HAND_STOP)
"""Stops are carried out under every fault while there is a link; a fault only affects their answers."""
_GARBAGE_BYTES = 64


class Spoilable(Protocol):
    """A part that accepts injected faults; both members may be set at any time, from any thread.

    Attributes:
        fault: the fault from now on.
        delay_s: how late answers come under ``slow`` [s].
    """

    fault: Fault
    delay_s: float


class Faulty:
    """Base of every part that accepts injected faults, at any time and from any thread.

    Subclasses wait on ``_turn`` for a change of the fault.

    Attributes:
        fault: the fault now.
        delay_s: how late answers come under ``slow`` [s].
    """

    def __init__(self, fault: Fault, delay_s: float) -> None:
        self._fault = fault
        self._turn = threading.Condition()
        self.delay_s = delay_s

    @property
    def fault(self) -> Fault:
        """The fault now; setting it wakes every waiting call."""
        return self._fault

    @fault.setter
    def fault(self, fault: Fault) -> None:
        with self._turn:
            self._fault = Fault(fault)
            self._turn.notify_all()
        self._on_fault(fault)

    def _on_fault(self, fault: Fault) -> None:
        """Hook for subclasses, called after the fault was set."""


class FaultyBus(Faulty, Bus):
    """A `Bus` whose own link has the fault ``fault``. Samples of other sessions still arrive, except under ``off``.

    ``off``: the session is closed, for good. ``stuck``: nothing is answered or published. ``garbage``: random bytes
    are sent. ``wrong``: a message of another type is sent. ``slow``: everything is sent ``delay_s`` late.
    """

    def __init__(
        self,
        session: zenoh.Session,
        cell_id: str,
        security: Path | None = None,
        *,
        is_host: bool = False,
        clock: DeadlineClock = WALL_CLOCK,
    ) -> None:
        Faulty.__init__(self, Fault.NONE, delay_s=1.0)
        Bus.__init__(self, session, cell_id, security, is_host=is_host, clock=clock)
        self._kept: list[zenoh.Query] = []  # never answered while stuck; guarded by `_turn`

    def _on_fault(self, fault: Fault) -> None:
        if fault is Fault.STUCK:
            return
        with self._turn:
            kept, self._kept = self._kept, []
        for query in kept:
            query.drop()  # type: ignore[no-untyped-call]

    def publish(self, topic: Topic, message: Message | bytes, **fields: str) -> None:
        """Publish as `Bus.publish`, changed as the fault says. Raises: BusError after close."""
        match self._fault:
            case Fault.STUCK:
                return
            case Fault.SLOW:
                self._tarry()
            case Fault.GARBAGE:
                message = os.urandom(_GARBAGE_BYTES)
            case Fault.WRONG:
                topic, message = replace(topic, says=FaultRequest), FaultRequest(fault=Fault.WRONG)
        super().publish(topic, message, **fields)

    def close(self) -> None:
        """End the fault, so that delayed answers return, then close the session."""
        self.fault = Fault.NONE  # ends the answers that wait in `_spoiled` and `_tarry`
        super().close()

    def _reply(
        self, topic: Topic, key: str, query: zenoh.Query, question: Asked, handler: Handler, answers: Answers
    ) -> None:
        if topic is topics.FAULT:
            super()._reply(topic, key, query, question, handler, answers)
            if self._fault is Fault.OFF:
                self._session.close()  # type: ignore[no-untyped-call]
            return
        if self._fault is not Fault.STUCK:
            spoiled = lambda payload, asked: self._spoiled(topic, handler(payload, asked))  # noqa: E731
            super()._reply(topic, key, query, question, spoiled, answers)
            return
        with self._turn:
            self._kept.append(query)
        if topic in _ALWAYS_DONE:
            handler(b"{}", question)

    def _spoiled(self, topic: Topic, answer: Message | list[Sample]) -> Message | list[Sample]:
        """Return the payload that is sent instead of ``answer``."""
        if topic not in _ALWAYS_DONE:  # a stop does not wait, so its worker stays free for the next stop
            with self._turn:
                self._turn.wait_for(lambda: self._fault is not Fault.STUCK)
        self._tarry()
        if self._fault not in (Fault.GARBAGE, Fault.WRONG):
            return answer
        parts = answer if isinstance(answer, list) else [Sample(topic.key, encoding_of(type(answer)), b"")]
        if self._fault is Fault.GARBAGE:
            return [part._replace(payload=os.urandom(_GARBAGE_BYTES)) for part in parts]
        other = FaultRequest(fault=Fault.WRONG)
        return [Sample(part.key, encoding_of(FaultRequest), encode(other)) for part in parts]

    def _tarry(self) -> None:
        with self._turn:
            if self._fault is Fault.SLOW:
                self._turn.wait_for(lambda: self._fault is not Fault.SLOW, self.delay_s)


def answer_faults(bus: Bus, parts: Mapping[str, Spoilable], publish: Callable[[Topic, Message], None]) -> None:
    """Answer ``fault/{part}`` for every part: set its fault, and publish an event about it.

    Args:
        parts: the parts by name.
        publish: sends the event.
    """
    for part, spoilable in parts.items():
        bus.answer(topics.FAULT, _setter(part, spoilable, publish), worker="fault", part=part)


def _event(part: str, fault: Fault) -> Event:
    if fault is Fault.NONE:
        return Event(code="FAULT_SET", severity="info", text=f"The injected fault of the {part} has ended.")
    text, advice = f"Injected fault of the {part}: {fault}.", f"End it: cell fault {part} none"
    return Event(code="FAULT_SET", severity="warning", text=text, advice=advice)


def _setter(part: str, spoilable: Spoilable, publish: Callable[[Topic, Message], None]) -> Handler:
    def set_fault(payload: bytes, _asked: Asked) -> Message:
        request = decode(FaultRequest, payload)
        if request.delay_s is not None:
            if not 0.0 <= request.delay_s <= 3600.0:  # written so that NaN fails
                raise BadPayload(f"delay_s = {request.delay_s} is no time between 0 and an hour.")
            spoilable.delay_s = request.delay_s
        publish(topics.EVENT, _event(part, request.fault))
        spoilable.fault = request.fault
        return Nothing()

    return set_fault
