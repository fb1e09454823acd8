"""The record of one cycle: whatever travels on the bus while it runs, written by a thread of its own.

Everything is queued at once and written in order; the file is flushed after every stage and state, and 100 ms after
anything else was queued at the latest, so that a killed daemon loses no more than that. Only that thread touches the
file: a disk that blocks keeps nobody else waiting for longer than the recording's patience. Nothing is ever left out:
when the disk takes less than what is said, until `BACKLOG_BYTES` wait, the recording has failed, and so has the cycle.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from bus import topics
from bus.codec import decode
from bus.codes import Code
from bus.errors import BadPayload, CycleFailure, RecordingError
from bus.messages import ModelReply
from bus.session import Heard
from logs.recorder import Recorder

_log = logging.getLogger(__name__)
FLUSH_PERIOD_S = 0.1
_FLUSH_AFTER = ("cycle/", "state")
BACKLOG_BYTES = 256 * 1024 * 1024
"""What may wait for the disk: ten seconds of an RGB-D camera at 30 Hz."""
_LOOK_S = 0.02

Open = Callable[[], Recorder]


class _Stamped(NamedTuple):
    heard: Heard
    log_time_ns: int


_DUE = _Stamped(Heard("", "", b""), 0)
"""Nothing was queued, and it is time to flush."""


class CycleLog:
    """Records one cycle.

    Args:
        open_recorder: opens the file; called in the writing thread.
        path: the final ``.mcap``.
        patience_s: a disk that takes longer for one step is lost.
        clock_ns: UTC clock.
        on_failure: called once, on any thread, as soon as the recording has failed: the cycle must stop.
    """

    def __init__(
        self,
        open_recorder: Open,
        path: Path,
        patience_s: float,
        clock_ns: Callable[[], int] = time.time_ns,
        on_failure: Callable[[CycleFailure], None] = lambda _: None,
    ) -> None:
        self.path = path
        self._clock_ns, self._patience_s, self._on_failure = clock_ns, patience_s, on_failure
        self._queue: queue.SimpleQueue[_Stamped | dict[str, str] | None] = queue.SimpleQueue()
        self._counting = threading.Lock()
        self._waiting_bytes = 0  # guarded by the above
        self._replies = 0
        self._error: RecordingError | None = None
        self._given_up = False
        self._step_began_s: float | None = time.monotonic()  # None between steps: the disk owes nothing
        self._opened = threading.Event()
        self._writer = threading.Thread(target=self._run, args=(open_recorder,), name="cycle-log", daemon=True)
        self._writer.start()

    def await_open(self) -> None:
        """Until the file is open. Raises: CycleFailure(RECORDING) when it cannot be."""
        self._await(self._opened.wait)

    def hear(self, heard: Heard) -> None:
        """Queue one payload; called from any thread, never blocks. Nothing is queued any more after an error."""
        with self._counting:  # queued in the order of their stamps
            if self._error is not None:
                return
            waiting_bytes = self._waiting_bytes + len(heard.payload)
            if waiting_bytes <= BACKLOG_BYTES:
                self._waiting_bytes = waiting_bytes
                self._queue.put(_Stamped(heard, self._clock_ns()))
                return
        text = f"The disk of {self.path} is too slow: {waiting_bytes / 1e6:.0f} MB wait to be written."
        self._fail(RecordingError(text, "Record onto a faster disk: set recording.folder."))

    @property
    def is_writing(self) -> bool:
        """Whether the file is still held: until it is closed, and after an error until the disk lets it go."""
        return self._writer.is_alive()

    def check(self) -> None:
        """Raises: CycleFailure(RECORDING) when writing failed since the start, or the disk has been taking too long."""
        began_s = self._step_began_s
        if self._error is None and began_s is not None and time.monotonic() - began_s > self._patience_s:
            self._fail(RecordingError(f"The disk of {self.path} blocks: nothing for {self._patience_s:.1f} s."))
        if self._error is not None:
            raise CycleFailure(Code.RECORDING, self._error.text) from self._error

    def close(self, result: Mapping[str, str]) -> None:
        """Write what is queued, finish the file and give it its final name. Raises: CycleFailure(RECORDING).

        After an error the file stays the ``.part`` it is.
        """
        self._queue.put(dict(result))
        self._await(self._closed)

    def _closed(self, timeout_s: float) -> bool:
        self._writer.join(timeout_s)
        return not self.is_writing

    def _await(self, is_done: Callable[[float], bool]) -> None:
        """Raises: CycleFailure(RECORDING); the writing thread ends then as soon as the disk lets it."""
        try:
            while not is_done(_LOOK_S):
                self.check()
            self.check()
        except CycleFailure:
            self._given_up = True
            self._queue.put(None)
            raise

    # --- the writing thread -------------------------------------------------------------------------------------------

    def _run(self, open_recorder: Open) -> None:
        try:
            recorder = open_recorder()
        except RecordingError as error:
            self._fail(error)
            return
        finally:
            self._step_began_s = None
            self._opened.set()
        try:
            self._write(recorder)
        except RecordingError as error:
            self._fail(error)
        except Exception as defect:  # noqa: BLE001 - else the cycle would go on, and nobody would write
            _log.exception("defect in the recording of %s", self.path)
            self._fail(RecordingError(f"{type(defect).__name__}: {defect}.", "This is a defect."))
        finally:
            self._step_began_s = None
            recorder.abandon()

    def _fail(self, error: RecordingError) -> None:
        with self._counting:
            if self._error is not None:  # said already
                return
            self._error = error
        self._on_failure(CycleFailure(Code.RECORDING, error.text))

    def _write(self, recorder: Recorder) -> None:
        """Until the result comes, which closes the file, or None. Raises: RecordingError."""
        due_s: float | None = None  # when the oldest message that is not flushed must be
        while not self._given_up:
            item = self._next(due_s)
            self._step_began_s = time.monotonic()
            if item is None:
                return
            if isinstance(item, dict):
                recorder.close(item)
                return
            if item is not _DUE:
                self._put(recorder, item)
                due_s = due_s or time.monotonic() + FLUSH_PERIOD_S
            if item.heard.key.startswith(_FLUSH_AFTER) or due_s is None or time.monotonic() >= due_s:
                recorder.flush()
                due_s = None
            self._step_began_s = None

    def _next(self, due_s: float | None) -> _Stamped | dict[str, str] | None:
        """What was queued next; `_DUE` when nothing was until ``due_s``."""
        try:
            return self._queue.get(timeout=None if due_s is None else max(0.0, due_s - time.monotonic()))
        except queue.Empty:
            return _DUE

    def _put(self, recorder: Recorder, item: _Stamped) -> None:
        heard = item.heard
        with self._counting:
            self._waiting_bytes -= len(heard.payload)
        try:
            recorder.write(heard.key, heard.encoding, heard.payload, log_time_ns=item.log_time_ns)
            if heard.key == topics.MODEL_REPLY.key:
                self._attach_reply(recorder, decode(ModelReply, heard.payload))
        except BadPayload as error:  # no type of ours, so there is no schema to record it with
            _log.warning("not recorded: %s: %s", heard.key, error.text)

    def _attach_reply(self, recorder: Recorder, reply: ModelReply) -> None:
        """Prompt, answer and picture of one call as files of their own, for whoever takes the recording apart."""
        name = f"{self._replies:02d}-{reply.step}"
        self._replies += 1
        recorder.attach(f"prompts/{name}.txt", "text/plain", reply.prompt.encode())
        if reply.text or reply.text_of_failure:
            recorder.attach(f"replies/{name}.txt", "text/plain", (reply.text or reply.text_of_failure).encode())
        if reply.image_png is not None:
            recorder.attach(f"goal_images/{name}.png", "image/png", reply.image_png)
