"""Keeps the recordings within `recording.keep_gb` and `keep_days`, and announces deletions a day ahead."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Literal, Protocol

from bus import topics
from bus.errors import RecordingError
from bus.frozen import Message
from bus.threads import OwnedThread, Role
from bus.topics import Topic
from cell.daemon.publisher import Observer
from config.schema import RecordingSettings
from logs.mcap.index import read_metadata
from logs.mcap.retention import Shelf, delete, in_words

_PERIOD_S = 60.0
_LONGEST_S = 3600.0
_SAID_AGAIN_S = 24 * 3600.0
_REST_S = 0.002
"""Pause between two recordings that are read: a thousand take two seconds, and the cycle is not slowed."""
_ADVICE = "Copy what you want to keep, pin it with an empty CYCLE.keep beside CYCLE.mcap, or raise that setting."


class PublishEvent(Protocol):
    """The signature of `cell.daemon.publisher.Publisher.publish_event`."""

    def __call__(
        self, code: str, severity: Literal["info", "warning", "error"], text: str, advice: str = "", /
    ) -> None: ...


class Retention:
    """A thread from `start` to `close`, if the settings limit recordings: a pass at the start and after cycles.

    Args:
        settings: limits in GB and days.
        clock_ns: UTC clock.
        period_s: least time between two passes.
    """

    def __init__(
        self,
        settings: RecordingSettings,
        publish_event: PublishEvent,
        clock_ns: Callable[[], int] = time.time_ns,
        period_s: float = _PERIOD_S,
    ) -> None:
        self._settings, self._publish_event, self._clock_ns, self._period_s = (
            settings,
            publish_event,
            clock_ns,
            period_s,
        )
        self._closing, self._due = threading.Event(), threading.Event()
        self._shelf = Shelf(settings.folder, read_metadata, lambda: time.sleep(_REST_S))
        self._said_ahead_s = -_SAID_AGAIN_S
        self._thread = OwnedThread(Role.RETENTION, self._run)

    def start(self) -> Retention:
        """Start the thread if the settings ever delete anything; return itself."""
        if self._settings.keep_gb or self._settings.keep_days:
            self._thread.start()
        return self

    def after_cycles(self, observer: Observer) -> Observer:
        """An observer that wraps ``observer`` and triggers a pass after every cycle."""

        def hear(topic: Topic, message: Message | bytes) -> None:
            if topic is topics.RESULT:
                self._due.set()
            observer(topic, message)

        return hear

    def close(self) -> None:
        """End the thread; idempotent."""
        self._closing.set()
        self._due.set()
        self._thread.join()

    def tidy(self) -> None:
        """Make one pass. A recording that cannot be deleted is published as an event, and retried in the next pass."""
        try:
            plan = self._shelf.plan(self._clock_ns(), self._settings)
        except RecordingError as error:
            self._publish_event("RETENTION_FAILED", "warning", error.text, error.advice)
            return
        gone = []
        for one in delete(plan.delete):
            if isinstance(one, RecordingError):
                self._publish_event("RETENTION_FAILED", "warning", one.text, one.advice)
            else:
                gone.append(one)
        if gone:
            self._publish_event("RETENTION", "info", f"Deleted {in_words(gone)}: {self._rule}.")
        if plan.soon and time.monotonic() - self._said_ahead_s >= _SAID_AGAIN_S:
            self._said_ahead_s = time.monotonic()
            text = f"Within a day {in_words(plan.soon)} will be deleted: {self._rule}."
            self._publish_event("RETENTION_AHEAD", "info", text, _ADVICE)

    @property
    def _rule(self) -> str:
        names = ("keep_gb", "keep_days")
        return ", ".join(f"recording.{name} = {value:g}" for name in names if (value := getattr(self._settings, name)))

    def _run(self) -> None:
        while not self._closing.is_set():
            self._due.clear()
            self.tidy()
            self._closing.wait(self._period_s)
            self._due.wait(_LONGEST_S)
