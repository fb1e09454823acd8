"""The messages that a client receives from its cell, and whether that is still there."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from contextlib import suppress

from bus import topics
from bus.errors import CellUnreachable
from bus.sample import Sample
from bus.session import Bus
from bus.topics import Topic
from cell.machine.leases import CELL_CLIENT

_ASK_AGAIN_S = 0.5
"""Time without a message after which the cell is asked, because a sample may have been lost."""


class Inbox:
    """States, results, and the samples of other topics.

    What the cell says is in the order in which it said it: who hears that a pick is complete has its result. The cell's
    own words are accepted from its own session alone.

    Args:
        also: topics to subscribe to besides states and results.

    Attributes:
        is_gone: the cell has ended, or the link to it.
    """

    def __init__(self, bus: Bus, also: tuple[Topic, ...]) -> None:
        self._bus, self._now_s = bus, bus.clock.now_s
        self.is_gone = False
        self._heard: queue.SimpleQueue[Sample | None] = queue.SimpleQueue()  # None: the cell is gone
        for topic in (topics.STATE, topics.RESULT, *also):
            hear = self._believe if topic.speaker == "cell" else self._heard.put
            bus.subscribe(topic.key.replace("{name}", "*"), hear, in_order=topic.speaker in ("cell", "both"))
        bus.watch_alive(topics.LEASE, self._notice)

    def drain(self) -> Iterator[Sample]:
        """Yield the samples received since the last call, oldest first; does not wait."""
        while not self._heard.empty():
            if (sample := self._heard.get_nowait()) is not None:
                yield sample

    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample of any topic; None after ``timeout_s`` without one, or when the cell is gone."""
        with suppress(queue.Empty):
            return self._heard.get(timeout=timeout_s)
        return None

    def next_of(self, wanted: tuple[Topic, ...], give_up_s: float) -> Sample | None:
        """Return the next sample on one of these topics; None after a short time without one.

        Raises: CellUnreachable.
        """
        give_up_s = min(give_up_s, self._now_s() + _ASK_AGAIN_S)
        while (left_s := give_up_s - self._now_s()) > 0:
            try:
                sample = self._heard.get(timeout=left_s)
            except queue.Empty:
                return None
            self.require_there()
            if sample is None:  # the cell was gone and is back
                continue
            if any(sample.key == topic.key for topic in wanted):
                return sample
        return None

    def require_there(self) -> None:
        """Refuse to wait for a lost cell. Raises: CellUnreachable."""
        if self.is_gone:
            raise CellUnreachable("The cell is gone: it ended, or the link to it.", "Start it, then see `cell cycles`.")

    def _believe(self, sample: Sample) -> None:
        """Keep a message of the cell; messages of other sessions on its keys are dropped."""
        if self._bus.cell in (None, sample.source):
            self._heard.put(sample)

    def _notice(self, client_id: str, is_alive: bool) -> None:
        if client_id == CELL_CLIENT:
            self.is_gone = not is_alive
            if self.is_gone:
                self._heard.put(None)
