"""Keeps the recordings within the rule of `RecordingSettings` between cycles, and announces deletions a day ahead."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Literal, Protocol

from bus import topics
from bus.errors import ArchiveError, CatalogueError, RecordingError
from bus.frozen import Message
from bus.threads import OwnedThread, Role
from bus.topics import Topic
from cell.daemon.publisher import Observer
from config.recording import RecordingSettings
from logs.mcap.retention import GB, Due, Plan, in_words
from logs.prune import Done, Pruner

_PERIOD_S = 60.0
_LONGEST_S = 3600.0
_SAID_AGAIN_S = 24 * 3600.0
_REST_S = 0.002
"""Pause between two recordings that are read: a thousand take two seconds, and the cycle is not slowed."""
_ADVICE = "Copy what you want to keep, pin it with an empty CYCLE.keep beside CYCLE.mcap, or raise that setting."
_SHORT = "Pinned and labelled recordings and the newest one stay: unpin some, or give the cell a larger disk."


class PublishEvent(Protocol):
    """The signature of `cell.daemon.publisher.Publisher.publish_event`."""

    def __call__(
        self, code: str, severity: Literal["info", "warning", "error"], text: str, advice: str = "", /
    ) -> None: ...


class Retention:
    """A thread from `start` to `close`, if the settings limit recordings: a pass at the start and after cycles.

    No recording goes while a cycle runs; a pass goes on where it was when the cycle has ended.

    Args:
        settings: folder, rule and archive.
        clock_ns: UTC clock.
        period_s: least time between two passes.

    Raises: ConfigError for an archive that cannot be used.
    """

    def __init__(
        self,
        settings: RecordingSettings,
        publish_event: PublishEvent,
        clock_ns: Callable[[], int] = time.time_ns,
        period_s: float = _PERIOD_S,
    ) -> None:
        self._settings, self._publish_event, self._period_s = settings, publish_event, period_s
        self._closing, self._due, self._between_cycles = threading.Event(), threading.Event(), threading.Event()
        self._between_cycles.set()
        self._pruner = Pruner(settings, lambda: time.sleep(_REST_S), clock_ns)
        self._said_s: dict[str, float] = {}
        self._thread = OwnedThread(Role.RETENTION, self._run)

    def start(self) -> Retention:
        """Start the thread if the settings ever delete anything; return itself."""
        if self._settings.rules:
            self._thread.start()
        return self

    def after_cycles(self, observer: Observer) -> Observer:
        """An observer that wraps ``observer``, waits while a cycle runs, and triggers a pass after every one."""

        def hear(topic: Topic, message: Message | bytes) -> None:
            if topic is topics.ATTEMPT:
                self._between_cycles.clear()
            if topic is topics.RESULT:
                self._between_cycles.set()
                self._due.set()
            observer(topic, message)

        return hear

    def close(self) -> None:
        """End the thread; idempotent."""
        self._closing.set()
        self._due.set()
        self._between_cycles.set()
        self._thread.join()

    def tidy(self) -> None:
        """Make one pass. What cannot be trimmed or deleted is published once a day, and tried in every pass."""
        try:
            with self._pruner.alone() as is_alone:
                if is_alone:
                    self._pass()
        except RecordingError as error:
            self._fail(error)

    def _pass(self) -> None:
        """Raises: RecordingError when the folder cannot be looked into."""
        plan = self._pruner.plan()
        if trimmed := self._do(plan.thin):
            self._publish_event("RETENTION", "info", f"Trimmed {_told(trimmed)}.")
            plan = self._pruner.plan()  # what was gained by that need not be deleted
        if gone := self._do(plan.delete):
            self._publish_event("RETENTION", "info", f"Deleted {_told(gone)}.")
        self._announce(plan)

    def _do(self, due: Sequence[Due]) -> list[Done]:
        done = []
        for one in due:
            self._between_cycles.wait()
            if self._closing.is_set():
                break
            try:
                went = self._pruner.do(one)
            except (ArchiveError, CatalogueError) as error:  # so would all others
                self._fail(error)
                break
            except RecordingError as error:
                self._fail(error)
                continue
            if went is not None:
                done.append(went)
        return done

    def _announce(self, plan: Plan) -> None:
        if plan.soon and self._is_time("RETENTION_AHEAD"):
            text = f"Within a day {in_words([one.file for one in plan.soon])} will be deleted: {_rules(plan.soon)}."
            self._publish_event("RETENTION_AHEAD", "info", text, _ADVICE)
        if plan.short and self._is_time("RETENTION_SHORT"):
            text = f"{plan.short} is not met, although all that may be deleted is."
            self._publish_event("RETENTION_SHORT", "warning", text, _SHORT)

    def _fail(self, error: RecordingError) -> None:
        if self._is_time(error.text):  # else with every pass, once a minute
            self._publish_event("RETENTION_FAILED", "warning", error.text, error.advice)

    def _is_time(self, what: str) -> bool:
        """Whether to say it: once a day."""
        now_s = time.monotonic()
        self._said_s = {one: said_s for one, said_s in self._said_s.items() if now_s - said_s < _SAID_AGAIN_S}
        if what in self._said_s:
            return False
        self._said_s[what] = now_s
        return True

    def _run(self) -> None:
        while not self._closing.is_set():
            self._due.clear()
            self.tidy()
            self._closing.wait(self._period_s)
            self._due.wait(_LONGEST_S)


def _told(done: Sequence[Done]) -> str:
    """``12 recordings (0.34 GB), 0.30 GB freed, archived: recording.keep_days = 30``."""
    copied = ", archived" if any(one.archived for one in done) else ""
    freed_gb = sum(one.freed_bytes for one in done) / GB
    due = [one.due for one in done]
    return f"{in_words([one.file for one in due])}, {freed_gb:.2f} GB freed{copied}: {_rules(due)}"


def _rules(due: Sequence[Due]) -> str:
    return ", ".join(sorted({one.why for one in due}))
