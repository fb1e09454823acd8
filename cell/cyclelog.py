"""The record of one cycle: whatever travels on the bus while it runs, written by a thread of its own.

Everything is queued at once and written in order; the file is flushed after every stage and state, and 100 ms after
anything else was queued at the latest, so that a killed daemon loses no more than that. Nothing is ever left out: when
the disk takes less than what is said, until `BACKLOG_BYTES` wait, the recording has failed, and so has the cycle.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

from bus import topics
from bus.codec import decode
from bus.codes import Code
from bus.errors import BadPayload, CycleFailure, RecordingError
from bus.messages import ModelReply
from bus.session import Heard
from logs.recorder import Recorder, open_part

_log = logging.getLogger(__name__)

_GATHER_S = 0.08
"""What comes within this time is written and flushed together: 20 ms are left of the 100 for doing so."""
BACKLOG_BYTES = 256 * 1024 * 1024
"""What may wait for the disk: ten seconds of an RGB-D camera at 30 Hz."""
_URGENT_BYTES = 8 * 1024 * 1024
_FLUSH_AFTER = ("cycle/", "state")


class _Stamped(NamedTuple):
    heard: Heard
    log_time_ns: int


class CycleLog:
    """Records one cycle into ``path``.

    Args:
        path: the final ``.mcap``.
        attachments: JSON documents by name, stored beside the messages.
        metadata: versions, seeds, hashes.
        clock_ns: UTC clock.
        on_failure: called once, on any thread, as soon as the recording has failed: the cycle must stop.
        opener: as `Recorder`'s.
    """

    def __init__(
        self,
        path: Path,
        attachments: Mapping[str, str],
        metadata: Mapping[str, str],
        clock_ns: Callable[[], int],
        on_failure: Callable[[CycleFailure], None] = lambda _: None,
        opener: Callable[[Path], BinaryIO] = open_part,
    ) -> None:
        self.path = path
        self._clock_ns, self._on_failure = clock_ns, on_failure
        self._recorder = Recorder(path, metadata=metadata, clock=clock_ns, opener=opener)
        for name, text in attachments.items():
            self._recorder.attach(name, "application/json", text.encode())
        self._recorder.flush()
        self._change = threading.Condition()
        self._queue: list[_Stamped] = []
        self._urgent = self._ending = False
        self._backlog_bytes = self._replies = 0
        self._error: RecordingError | None = None
        self._writer = threading.Thread(target=self._write, name="cycle-log", daemon=True)
        self._writer.start()

    def hear(self, heard: Heard) -> None:
        """Queue one payload; called from any thread, never waits for the disk."""
        too_slow: RecordingError | None = None
        with self._change:  # queued in the order of their stamps
            if self._error is not None:
                return
            if self._backlog_bytes + len(heard.payload) > BACKLOG_BYTES:
                self._error = too_slow = RecordingError(
                    f"The disk of {self.path} is too slow: {self._backlog_bytes / 1e6:.0f} MB wait to be written.",
                    "Record onto a faster disk: set recording.folder.",
                )
            else:
                self._backlog_bytes += len(heard.payload)
                self._queue.append(_Stamped(heard, self._clock_ns()))
                urgent = heard.key.startswith(_FLUSH_AFTER) or self._backlog_bytes > _URGENT_BYTES
                self._urgent = self._urgent or urgent
                if urgent or len(self._queue) == 1:
                    self._change.notify()
        if too_slow is not None:
            self._on_failure(CycleFailure(Code.RECORDING, too_slow.text))

    def check(self) -> None:
        """Raises: CycleFailure(RECORDING) when writing failed since the start."""
        if self._error is not None:
            raise CycleFailure(Code.RECORDING, self._error.text) from self._error

    def close(self, result: Mapping[str, str]) -> None:
        """Write what is queued, finish the file and give it its final name. Raises: CycleFailure(RECORDING)."""
        with self._change:
            self._ending = True
            self._change.notify()
        self._writer.join()
        try:
            self.check()
            self._recorder.close(result)
        except RecordingError as error:
            raise CycleFailure(Code.RECORDING, error.text) from error
        finally:
            self._recorder.abandon()

    # --- the writing thread -------------------------------------------------------------------------------------------

    def _write(self) -> None:
        try:
            self._write_all()
        except RecordingError as error:
            self._fail(error)
        except Exception as defect:  # noqa: BLE001 - else the cycle would go on, and nobody would write
            _log.exception("defect in the recording of %s", self.path)
            self._fail(RecordingError(f"{type(defect).__name__}: {defect}.", "This is a defect."))

    def _fail(self, error: RecordingError) -> None:
        with self._change:
            if self._error is not None:  # said already
                return
            self._error = error
        self._on_failure(CycleFailure(Code.RECORDING, error.text))

    def _write_all(self) -> None:
        """Batch by batch, each written and flushed, until the end. Raises: RecordingError."""
        while (batch := self._next_batch()) and self._error is None:
            for item in batch:
                try:
                    self._write_one(item)
                except BadPayload as error:  # a stranger on the bus said what no topic says
                    _log.warning("not recorded on %s: %s", item.heard.key, error)
            self._recorder.flush()

    def _next_batch(self) -> list[_Stamped]:
        """What was heard until something urgent, or the period from the first of it, is over; [] = the end.

        Waking for every message would cost more than writing it.
        """
        with self._change:
            self._change.wait_for(lambda: self._queue or self._ending)
            self._change.wait_for(lambda: self._urgent or self._ending, _GATHER_S)
            batch, self._queue, self._urgent = self._queue, [], False
            return batch

    def _write_one(self, item: _Stamped) -> None:
        heard = item.heard
        self._recorder.write(heard.key, heard.encoding, heard.payload, log_time_ns=item.log_time_ns)
        with self._change:
            self._backlog_bytes -= len(heard.payload)
        if heard.key == topics.MODEL_REPLY.key:
            self._attach_reply(decode(ModelReply, heard.payload))

    def _attach_reply(self, reply: ModelReply) -> None:
        """Prompt, answer and picture of one call as files of their own, for whoever takes the recording apart."""
        name = f"{self._replies:02d}-{reply.step}"
        self._replies += 1
        self._recorder.attach(f"prompts/{name}.txt", "text/plain", reply.prompt.encode())
        if reply.text or reply.text_of_failure:
            self._recorder.attach(f"replies/{name}.txt", "text/plain", (reply.text or reply.text_of_failure).encode())
        if reply.image_png is not None:
            self._recorder.attach(f"goal_images/{name}.png", "image/png", reply.image_png)
