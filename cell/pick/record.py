"""The record of one cycle: all messages on the bus while it runs, written by a thread of its own.

Messages are queued immediately and written in order. The file is flushed after every stage and state, and at most 100
ms after any other message was queued, so a killed daemon loses no more than that. Only the writing thread touches the
file: a blocked disk delays no other thread for longer than the recording's patience. No message is ever left out: when
the disk is so slow that `BACKLOG_BYTES` wait, the recording has failed, and so has the cycle.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from bus import topics
from bus.clock import WALL_CLOCK, DeadlineClock
from bus.codec import decode
from bus.codes import Code
from bus.errors import BadPayload, CycleFailure, RecordingError
from bus.messages import ModelReply
from bus.sample import Sample
from bus.threads import OwnedThread, Role, report_defect
from logs.mcap.recorder import Recorder

_log = logging.getLogger(__name__)
_GATHER_S = 0.08
"""Messages within this time are written and flushed together, which leaves 20 of the 100 ms for the writing."""
BACKLOG_BYTES = 256 * 1024 * 1024
"""Largest backlog for the disk: ten seconds of an RGB-D camera at 30 Hz."""
_URGENT_BYTES = 8 * 1024 * 1024
_FLUSH_AFTER = ("cycle/", "state")
_LOOK_S = 0.02

Open = Callable[[], Recorder]


class _Stamped(NamedTuple):
    sample: Sample
    log_time_ns: int


class CycleLog:
    """Records one cycle.

    Args:
        open_recorder: opens the file; called in the writing thread.
        path: the final ``.mcap``.
        patience_s: longest duration of one step of the disk.
        gather_s: samples that come within this time are written and flushed together.
        backlog_bytes: how much may wait for the disk.
        clock_ns: UTC clock.
        on_failure: called once, on any thread, as soon as the recording has failed: the cycle must stop.
        clock: the clock of ``patience_s``.
    """

    def __init__(
        self,
        open_recorder: Open,
        path: Path,
        patience_s: float,
        clock_ns: Callable[[], int] = time.time_ns,
        on_failure: Callable[[CycleFailure], None] = lambda _: None,
        gather_s: float = _GATHER_S,
        backlog_bytes: int = BACKLOG_BYTES,
        clock: DeadlineClock = WALL_CLOCK,
    ) -> None:
        self.path = path
        self._clock_ns, self._patience_s, self._on_failure = clock_ns, patience_s, on_failure
        self._gather_s, self._backlog_bytes, self._clock = gather_s, backlog_bytes, clock
        self._change = threading.Condition()  # guards the six attributes below
        self._queue: list[_Stamped] = []
        self._waiting_bytes = 0
        self._urgent = self._ending = False
        self._result: dict[str, str] | None = None
        self._error: RecordingError | None = None
        self._replies = 0
        self._step_began_s: float | None = clock.now_s()  # None between steps
        self._opened = threading.Event()
        self._writer = OwnedThread(Role.CYCLE_LOG, lambda: self._run(open_recorder)).start()

    def await_open(self) -> None:
        """Wait until the file is open. Raises: CycleFailure(RECORDING) when it cannot be opened."""
        self._await(self._opened.wait)

    def hear(self, sample: Sample) -> None:
        """Queue one payload; called from any thread, never blocks. After an error nothing is queued."""
        with self._change:  # queue in the order of the stamps
            if self._error is not None:
                return
            waiting_bytes = self._waiting_bytes + len(sample.payload)
            if waiting_bytes <= self._backlog_bytes:
                self._waiting_bytes = waiting_bytes
                self._queue.append(_Stamped(sample, self._clock_ns()))
                urgent = sample.key.startswith(_FLUSH_AFTER) or waiting_bytes > _URGENT_BYTES
                self._urgent = self._urgent or urgent
                if urgent or len(self._queue) == 1:
                    self._change.notify()
                return
        text = f"The disk of {self.path} is too slow: {waiting_bytes / 1e6:.0f} MB wait to be written."
        self._fail(RecordingError(text, "Record onto a faster disk: set recording.folder."))

    @property
    def is_writing(self) -> bool:
        """True while the file is held: until it is closed, or after an error until the disk operation ends."""
        return self._writer.is_alive()

    def check(self) -> None:
        """Raises: CycleFailure(RECORDING) when writing has failed, or the disk is taking too long."""
        began_s = self._step_began_s
        if self._error is None and began_s is not None and self._clock.now_s() - began_s > self._patience_s:
            text = f"The disk of {self.path} blocks: nothing for {self._patience_s:.1f} s.{self._clock.busy_note()}"
            self._fail(RecordingError(text))
        if self._error is not None:
            raise CycleFailure(Code.RECORDING, self._error.text) from self._error

    def close(self, result: Mapping[str, str]) -> None:
        """Write the queue, finish the file and give it its final name. After an error the file remains a ``.part``.

        Raises: CycleFailure(RECORDING).
        """
        self._end(dict(result))
        self._await(self._closed)

    def _closed(self, timeout_s: float) -> bool:
        self._writer.join(timeout_s)
        return not self.is_writing

    def _end(self, result: dict[str, str] | None) -> None:
        with self._change:
            self._ending, self._result = True, result
            self._change.notify()

    def _await(self, is_done: Callable[[float], bool]) -> None:
        """Raises: CycleFailure(RECORDING); the writing thread then ends as soon as the disk operation does."""
        try:
            while not is_done(_LOOK_S):
                self.check()
            self.check()
        except CycleFailure:
            self._end(None)
            raise

    def _fail(self, error: RecordingError) -> None:
        with self._change:
            if self._error is not None:  # reported already
                return
            self._error = error
            self._change.notify()
        self._on_failure(CycleFailure(Code.RECORDING, error.text))

    # --- the writing thread -------------------------------------------------------------------------------------------

    def _run(self, open_recorder: Open) -> None:
        """Write until the end; any error fails the recording, because the cycle must not go on without a writer."""
        recorder: Recorder | None = None
        try:
            recorder = open_recorder()
            self._step_began_s = None
            self._opened.set()
            self._write(recorder)
        except RecordingError as error:
            self._fail(error)
        except Exception as defect:  # noqa: BLE001 - see the docstring
            report_defect(str(Role.CYCLE_LOG), defect)
            self._fail(RecordingError(f"{type(defect).__name__}: {defect}.", "This is a defect: please report it."))
        finally:
            self._step_began_s = None
            self._opened.set()
            if recorder is not None:
                recorder.abandon()

    def _write(self, recorder: Recorder) -> None:
        """Write and flush batch by batch; at the end the result closes the file. Raises: RecordingError."""
        while (batch := self._next_batch()) and self._error is None:
            for item in batch:
                self._step_began_s = self._clock.now_s()
                self._put(recorder, item)
            recorder.flush()
            self._step_began_s = None
        if self._result is not None and self._error is None:
            self._step_began_s = self._clock.now_s()
            recorder.close(self._result)

    def _next_batch(self) -> list[_Stamped]:
        """The messages up to an urgent one, or until the period since the first one is over; [] = the end.

        Waking for every message would cost more than writing it.
        """
        with self._change:
            self._change.wait_for(lambda: self._queue or self._ending or self._error)
            self._change.wait_for(lambda: self._urgent or self._ending or self._error, self._gather_s)
            batch, self._queue, self._urgent = self._queue, [], False
            return batch

    def _put(self, recorder: Recorder, item: _Stamped) -> None:
        sample = item.sample
        try:
            recorder.write(sample.key, sample.encoding, sample.payload, log_time_ns=item.log_time_ns)
            if sample.key == topics.MODEL_REPLY.key:
                self._attach_reply(recorder, decode(ModelReply, sample.payload))
        except BadPayload as error:  # an unknown type has no schema to record it with
            _log.warning("not recorded on %s: %s", sample.key, error.text)
        with self._change:
            self._waiting_bytes -= len(sample.payload)

    def _attach_reply(self, recorder: Recorder, reply: ModelReply) -> None:
        """Attach prompt, answer and picture of one call as separate files, for readers of the recording."""
        name = f"{self._replies:02d}-{reply.step}"
        self._replies += 1
        recorder.attach(f"prompts/{name}.txt", "text/plain", reply.prompt.encode())
        if reply.text or reply.text_of_failure:
            recorder.attach(f"replies/{name}.txt", "text/plain", (reply.text or reply.text_of_failure).encode())
        if reply.image_png is not None:
            recorder.attach(f"goal_images/{name}.png", "image/png", reply.image_png)
