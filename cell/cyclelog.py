"""The record of one cycle: whatever travels on the bus while it runs, written by a thread of its own.

Everything is queued at once and written in order; the file is flushed after every stage and state, and at least every
100 ms, so that a killed daemon loses no more than that. Only that thread touches the file: a disk that blocks keeps
nobody else waiting for longer than the recording's patience, and what waits to be written is bounded.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from bus.codes import Code
from bus.errors import BadPayload, CycleFailure, RecordingError
from bus.session import Heard
from logs.recorder import Recorder

_log = logging.getLogger(__name__)
FLUSH_PERIOD_S = 0.1
_FLUSH_AFTER = ("cycle/", "state")
_MAX_WAITING_BYTES = 256 * 1024 * 1024
_LOOK_S = 0.02

Open = Callable[[], Recorder]


class _Stamped(NamedTuple):
    heard: Heard
    log_time_ns: int


class CycleLog:
    """Records one cycle.

    Args:
        open_recorder: opens the file; called in the writing thread.
        path: the final ``.mcap``.
        patience_s: a disk that takes longer for one step is lost.
        clock_ns: UTC clock.
    """

    def __init__(
        self, open_recorder: Open, path: Path, patience_s: float, clock_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self.path = path
        self._clock_ns, self._patience_s = clock_ns, patience_s
        self._queue: queue.SimpleQueue[_Stamped | dict[str, str] | None] = queue.SimpleQueue()
        self._counting = threading.Lock()
        self._waiting_bytes = 0  # guarded by the above
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
        with self._counting:
            if self._error is None and self._waiting_bytes > _MAX_WAITING_BYTES:
                megabytes = self._waiting_bytes / 1e6
                self._error = RecordingError(f"The disk of {self.path} is too slow: {megabytes:.0f} MB wait for it.")
            if self._error is not None:
                return
            self._waiting_bytes += len(heard.payload)
        self._queue.put(_Stamped(heard, self._clock_ns()))

    @property
    def is_writing(self) -> bool:
        """Whether the file is still held: until it is closed, and after an error until the disk lets it go."""
        return self._writer.is_alive()

    def check(self) -> None:
        """Raises: CycleFailure(RECORDING) when writing failed since the start, or the disk has been taking too long."""
        began_s = self._step_began_s
        if self._error is None and began_s is not None and time.monotonic() - began_s > self._patience_s:
            self._error = RecordingError(f"The disk of {self.path} blocks: nothing for {self._patience_s:.1f} s.")
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
        except RecordingError as error:  # kept for check(): the cycle's thread turns it into a controlled stop
            self._fail(error)
        finally:
            self._step_began_s = None
            recorder.abandon()

    def _fail(self, error: RecordingError) -> None:
        with self._counting:
            self._error = self._error or error

    def _write(self, recorder: Recorder) -> None:
        """Until the result comes, which closes the file, or None. Raises: RecordingError."""
        flushed_s = time.monotonic()
        while not self._given_up:
            try:
                item = self._queue.get(timeout=FLUSH_PERIOD_S)
            except queue.Empty:
                item = _Stamped(Heard("", "", b""), 0)
            self._step_began_s = time.monotonic()
            if item is None:
                return
            if isinstance(item, dict):
                recorder.close(item)
                return
            self._put(recorder, item)
            if time.monotonic() - flushed_s > FLUSH_PERIOD_S or item.heard.key.startswith(_FLUSH_AFTER):
                recorder.flush()
                flushed_s = time.monotonic()
            self._step_began_s = None

    def _put(self, recorder: Recorder, item: _Stamped) -> None:
        heard = item.heard
        with self._counting:
            self._waiting_bytes -= len(heard.payload)
        if not heard.key:
            return
        try:
            recorder.write(heard.key, heard.encoding, heard.payload, log_time_ns=item.log_time_ns)
        except BadPayload as error:  # no type of ours, so there is no schema to record it with
            _log.warning("not recorded: %s: %s", heard.key, error.text)
