"""Publishes the daemon's messages on the bus and to an observer, and keeps the last published state."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

from bus import topics
from bus.commands import CellState, Event, UnitMode
from bus.errors import BusError, RecordingError
from bus.frozen import Message
from bus.session import Bus
from bus.topics import Topic
from cell.machine.states import COMMANDS, ENDED, PAUSES, State, available
from logs.live_views import Views, pictures
from logs.mcap.recover import Recovered

_log = logging.getLogger(__name__)

Observer = Callable[[Topic, "Message | bytes"], None]


class Publisher:
    """The publisher of the daemon. Every member may be called from any thread.

    Args:
        views: draws the visualisation of a message.
        observer: called with every message, on the publishing thread; it may only enqueue.
        cycle_id: gives the open cycle's id now, or "".
        mode: gives the mode of the unit.
        in_hand: says that something may be in the hand, "" when nothing is; it stands in the reason of a cell at rest.
        jobs: gives the id of the job under way, or "", and those of the waiting ones.
        asked_by: gives the client that asked for the open cycle or the job under way, or "".

    Attributes:
        state: as last published.
    """

    def __init__(
        self,
        bus: Bus,
        views: Views,
        observer: Observer,
        cycle_id: Callable[[], str],
        jobs: Callable[[], tuple[str, tuple[str, ...]]] = lambda: ("", ()),
        mode: Callable[[], UnitMode] = lambda: "Production",
        in_hand: Callable[[], str] = lambda: "",
        asked_by: Callable[[], str] = lambda: "",
    ) -> None:
        self._asked_by = asked_by
        self._mode, self._in_hand, self._reason = mode, in_hand, ""
        self._bus, self._views, self._observer, self._cycle_id, self._jobs = bus, views, observer, cycle_id, jobs
        self._saying = threading.Lock()
        self.state = CellState(state="", stage="", cycle_id="", since_ns=0, available=(), reason="")

    def publish(self, topic: Topic, message: Message | bytes) -> None:
        """Publish a message, with its visualisation."""
        try:
            self._bus.publish(topic, message)
            for view, picture in pictures(self._views.of, message):
                self._bus.publish(view, picture)
        except BusError as error:  # closing: the observer below still receives it
            _log.warning("%s", error)
        self._observer(topic, message)

    def publish_event(
        self, code: str, severity: Literal["info", "warning", "error"], text: str, advice: str = ""
    ) -> None:
        """Publish an event for the operator."""
        self.publish(topics.EVENT, Event(code=code, severity=severity, text=text, advice=advice))

    def publish_state(self, state: State, reason: str) -> None:
        """Publish the machine's new state. Hold states, and the way back from them, keep the cycle's stage."""
        with self._saying:
            was_held = self.state.state in PAUSES and state in COMMANDS["hold"]
            stage = self.state.stage if was_held or state in PAUSES else ""
            self._publish_state(state, stage, reason)

    def publish_stage(self, stage: str) -> None:
        """Publish that a stage of the open cycle began, or a motion by hand, which ends the reason of the rest.

        A stage begins while the cell is held or stopped, too, if it moves nothing: the state keeps its reason.
        """
        with self._saying:  # the machine's owner thread may be publishing another state
            state = State(self.state.state)
            self._publish_state(state, stage, "" if state is State.STOPPED else self._reason)

    def publish_jobs(self) -> None:
        """Publish the state again, because the jobs of its queue have changed, or the mode."""
        with self._saying:
            job_id, queue = self._jobs()
            state, stage, mode = State(self.state.state), self.state.stage, self._mode()
            can = available(state, stage, mode)
            now = {"job_id": job_id, "queue": queue, "asked_by": self._asked_by(), "mode": mode, "available": can}
            self.state = self.state.model_copy(update=now)
            self.publish(topics.STATE, self.state)

    def publish_in_hand(self) -> None:
        """Publish the state again when what may be in the hand has changed since it was published."""
        with self._saying:
            reason = self._with_hand(State(self.state.state), self._reason)
            if reason != self.state.reason:
                self.state = self.state.model_copy(update={"reason": reason})
                self.publish(topics.STATE, self.state)

    def _with_hand(self, state: State, reason: str) -> str:
        """The reason of a state, and after the end of a pick what may be in the hand."""
        return " ".join(filter(None, (reason, self._in_hand() if state in ENDED else "")))

    def _publish_state(self, state: State, stage: str, reason: str) -> None:
        job_id, queue = self._jobs()
        self._reason = reason
        self.state = CellState(
            state=state,
            stage=stage,
            cycle_id=self._cycle_id(),
            since_ns=time.time_ns(),
            available=available(state, stage, self._mode()),
            reason=self._with_hand(state, reason),
            job_id=job_id,
            queue=queue,
            asked_by=self._asked_by(),
            mode=self._mode(),
        )
        self.publish(topics.STATE, self.state)

    def publish_recovered(self, leftovers: Iterable[Recovered | RecordingError]) -> None:
        """Publish what became of the recordings that an earlier process left unfinished; a pick was cut off there."""
        cut_off = ""
        for leftover in leftovers:
            if isinstance(leftover, RecordingError):
                self.publish_event("NOT_RECOVERED", "warning", leftover.text, leftover.advice)
            else:
                self.publish_event("RECOVERED", "warning" if leftover.lost else "info", f"{leftover.line()}.")
                cut_off = max(cut_off, Path(leftover.path).stem) if leftover.ended == "torn" else cut_off
        if cut_off:
            self._publish_cut_off(cut_off)

    def _publish_cut_off(self, cycle_id: str) -> None:
        """Publish that the last pick did not end, in one event, and in the reason for as long as nobody commands."""
        text = f"The last pick, {cycle_id}, was cut off: the cell's program ended in it."
        look = "Look at the arm, and whether something is in the hand."
        self.publish_event("PICK_CUT_OFF", "warning", text, f"{look} What was recorded: `cell show {cycle_id}`.")
        with self._saying:
            if self.state.state == State.STOPPED:
                self._reason = f"{text} {look}"
        self.publish_in_hand()
