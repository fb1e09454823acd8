"""The record of one cycle: whatever travels on the bus while it runs, written by a thread of its own.

Everything is queued at once and written in order; the file is flushed after every stage and state, and at least every
100 ms, so that a killed daemon loses no more than that.
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


class _Stamped(NamedTuple):
    heard: Heard
    log_time_ns: int


class CycleLog:
    """Records one cycle into ``path``.

    Args:
        path: the final ``.mcap``.
        station_json: attached as ``station.json``.
        metadata: versions, seeds, hashes.
        clock_ns: UTC clock.
    """

    def __init__(self, path: Path, station_json: str, metadata: Mapping[str, str], clock_ns: Callable[[], int]) -> None:
        self.path = path
        self._clock_ns = clock_ns
        self._recorder = Recorder(path, metadata=metadata, clock=clock_ns)
        self._recorder.attach("station.json", "application/json", station_json.encode())
        self._queue: queue.SimpleQueue[_Stamped | None] = queue.SimpleQueue()
        self._error: RecordingError | None = None
        self._writer = threading.Thread(target=self._write, name="cycle-log", daemon=True)
        self._writer.start()

    def hear(self, heard: Heard) -> None:
        """Queue one payload; called from any thread, never blocks."""
        self._queue.put(_Stamped(heard, self._clock_ns()))

    def check(self) -> None:
        """Raises: CycleFailure(RECORDING) when writing failed since the start."""
        if self._error is not None:
            raise CycleFailure(Code.RECORDING, self._error.text) from self._error

    def close(self, result: Mapping[str, str]) -> None:
        """Write what is queued, finish the file and give it its final name. Raises: CycleFailure(RECORDING)."""
        self._queue.put(None)
        self._writer.join()
        try:
            self.check()
            self._recorder.close(result)
        except RecordingError as error:
            raise CycleFailure(Code.RECORDING, error.text) from error
        finally:
            self._recorder.abandon()

    def _write(self) -> None:
        flushed_s = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=FLUSH_PERIOD_S)
            except queue.Empty:
                item = _Stamped(Heard("", "", b""), 0)
            if item is None:
                return
            try:
                if item.heard.key:
                    self._recorder.write(
                        item.heard.key, item.heard.encoding, item.heard.payload, log_time_ns=item.log_time_ns
                    )
                due = time.monotonic() - flushed_s > FLUSH_PERIOD_S
                if due or item.heard.key.startswith(_FLUSH_AFTER):
                    self._recorder.flush()
                    flushed_s = time.monotonic()
            except BadPayload as error:  # somebody speaks what the table does not know; the rest is still recorded
                _log.warning("%s is not recorded: %s", item.heard.key, error)
            except RecordingError as error:  # kept for check(): the cycle's thread turns it into a controlled stop
                self._error = error
                return
