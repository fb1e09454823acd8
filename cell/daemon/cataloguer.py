"""Writes a row into the catalogue when a cycle's recording is closed. What goes wrong there ends no cycle."""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

from bus import topics
from bus.errors import CatalogueError, RecordingError
from bus.frozen import Message
from bus.messages import CycleResult
from bus.threads import OwnedThread, Role
from bus.topics import Topic
from cell.daemon.publisher import Observer
from cell.daemon.retention import PublishEvent
from logs.catalogue.opening import open_store, set_aside
from logs.catalogue.rows import file_of, row_of
from logs.catalogue.store import DamagedCatalogue, Store
from logs.catalogue.update import listing, update
from logs.mcap.names import is_folder

_log = logging.getLogger(__name__)
_REST_S = 0.05
"""Pause between two recordings that are read at the start: a third of a core, and only until all are known."""
_SAID_AGAIN_S = 3600.0
_ADVICE = "Nothing is lost: the recordings are whole, and `cell catalogue rebuild` reads what is missing."


class Cataloguer:
    """A thread from `start` to `close`: first the recordings that have no row yet, then every cycle that closes.

    Args:
        folder: of the recordings. ``rest``: called between two recordings that are read at the start.
    """

    def __init__(
        self, folder: Path, publish_event: PublishEvent, rest: Callable[[], None] = lambda: time.sleep(_REST_S)
    ) -> None:
        self._folder, self._publish_event, self._rest = folder, publish_event, rest
        self._due: queue.SimpleQueue[Path | None] = queue.SimpleQueue()
        self._closing = False
        self._said_s = -_SAID_AGAIN_S
        self._store: Store | None = None
        self._thread = OwnedThread(Role.CATALOGUE, self._run)

    def start(self) -> Cataloguer:
        """Start the thread; return itself."""
        self._thread.start()
        return self

    def after_cycles(self, observer: Observer) -> Observer:
        """An observer that wraps ``observer`` and queues the recording of every cycle."""

        def hear(topic: Topic, message: Message | bytes) -> None:
            if topic is topics.RESULT and isinstance(message, CycleResult):
                self._due.put(Path(message.recording))
            observer(topic, message)

        return hear

    def close(self) -> None:
        """Write what is queued, and end the thread; idempotent."""
        self._closing = True
        self._due.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            self._guarded(self._catch_up)
            while (path := self._due.get()) is not None:
                self._guarded(partial(self._add, path))
        finally:
            if self._store is not None:
                self._store.close()

    def _guarded(self, work: Callable[[], None]) -> None:
        """Do it, once more with a new file if the catalogue is damaged; publish what else goes wrong, even a defect.

        No defect of what is derived may end a pick.
        """
        try:
            try:
                work()
            except DamagedCatalogue as error:
                self._forget()
                kept = set_aside(self._folder)
                self._tell(f"{error.text} It is kept as {kept.name}, and made anew.")
                self._catch_up()
        except _Closing:
            return
        except RecordingError as error:
            self._fail(error.text)
        except Exception as defect:  # noqa: BLE001 - see the docstring
            _log.critical("defect in the catalogue", exc_info=defect)
            self._fail(f"The catalogue is not written: {type(defect).__name__}: {defect}. This is a defect.")

    def _fail(self, text: str) -> None:
        """Publish why nothing is written, at most once an hour; the next cycle tries again."""
        self._forget()
        if time.monotonic() - self._said_s >= _SAID_AGAIN_S:
            self._said_s = time.monotonic()
            self._publish_event("CATALOGUE_FAILED", "warning", text, _ADVICE)

    def _catch_up(self) -> None:
        """Make the rows of all recordings that have none. Raises: RecordingError."""
        if is_folder(self._folder):
            store = self._opened()
            update(store, listing(store), rest=self._between)

    def _between(self) -> None:
        """Rest, or end what takes long. Raises: CatalogueError when the daemon closes."""
        if self._closing:
            raise _Closing
        with suppress(queue.Empty):  # cycles do not wait for the older ones
            while (path := self._due.get_nowait()) is not None:
                self._add(path)
            self._due.put(None)
        self._rest()

    def _add(self, path: Path) -> None:
        """Write the row of one recording; nothing of a file that was not closed. Raises: CatalogueError."""
        try:
            file = file_of(path, self._folder)
        except RecordingError:  # its disk failed, or it is deleted already
            return
        self._opened().put([row_of(self._folder, file)])

    def _opened(self) -> Store:
        """The catalogue, opened again if another process has replaced it. Raises: CatalogueError."""
        if self._store is not None and not self._store.is_current():
            self._forget()
        if self._store is None:
            self._store = open_store(self._folder, self._tell)
        return self._store

    def _forget(self) -> None:
        if self._store is not None:
            self._store.close()
            self._store = None

    def _tell(self, text: str) -> None:
        self._publish_event("CATALOGUE", "info", text)


class _Closing(CatalogueError):
    """The daemon closes before all older recordings were read."""

    def __init__(self) -> None:
        super().__init__("The cell closes.")
