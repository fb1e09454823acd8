"""Identifies the sender of a sample: the cell itself, one of its nodes, or a stranger, which is never taken for them.

A node's session is learned by requesting the node's health when its token arrives: exactly one session may answer.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Collection
from functools import lru_cache, partial

from bus import topics
from bus.codec import encode, process_in_words
from bus.commands import Stranger
from bus.errors import BusError
from bus.sample import Sample
from bus.session import Bus
from bus.topics import Topic, encoding_of

_ASK_S = 1.0
_AGAIN_S = 0.5
_KEPT_BYTES = 64 * 1024
_KEPT_SOURCES = 64
_WORKER = "speakers"
_PATTERNS = tuple(
    (re.compile(re.sub(r"\\{\w+\\}", "[^/]+", re.escape(topic.key))), topic)
    for topic in topics.TOPICS
    if topic.kind == "publish"
)

Twice = Callable[[str, str], None]
"""Called with the name that two nodes share, and their identities."""


class Speakers:
    """Separates samples of the cell's nodes from those of strangers.

    Args:
        bus: the cell's own session. ``names``: of its nodes. ``sealed``: the nodes that hold the cell's secret.
        on_twice: called when two sessions answer as one node, on a thread of the bus.
        on_stranger: called with the first sample of each strange session and key.
    """

    def __init__(
        self,
        bus: Bus,
        names: set[str],
        on_twice: Twice,
        on_stranger: Callable[[Sample], None],
        sealed: Collection[str] = (),
    ) -> None:
        self._bus, self._names, self._sealed = bus, names, frozenset(sealed)
        self._on_twice, self._on_stranger = on_twice, on_stranger
        self._changing = threading.Lock()
        self._sessions: dict[str, str] = {}  # of the nodes, by name
        self._asked_s = 0.0
        self._strangers: set[tuple[str, str]] = set()

    def listen(self) -> None:
        """Learn the nodes' sessions as their tokens come and go."""
        self._bus.watch_alive(topics.NODE_ALIVE, self.change)

    def change(self, name: str, is_alive: bool) -> None:
        """Process the arrival or the end of a node's token."""
        if name not in self._names:
            return
        with self._changing:
            self._sessions.pop(name, None)
        if is_alive:
            self._bus.worker(_WORKER).post(partial(self._learn, name))

    def _learn(self, name: str) -> None:
        try:
            answers = self._bus.sessions(topics.NODE_NOW, timeout_s=_ASK_S, name=name)
        except BusError:  # closing, or no answer: requested again at its next sample
            return
        if len(answers) > 1:
            self._on_twice(name, " and ".join(process_in_words(said) for said in answers.values()))
        elif answers:
            with self._changing:
                self._sessions[name] = next(iter(answers))

    def is_ours(self, sample: Sample) -> bool:
        """True for a sample of one of the cell's nodes, on a key that nodes publish on.

        The first sample of a strange session on a key is reported to ``on_stranger``.
        """
        topic = topic_of(sample.key)
        if topic is not None and topic.speaker in ("node", "both") and self._is_nodes(sample):
            return True
        self._look_again()
        with self._changing:
            is_new = (sample.source, sample.key) not in self._strangers and len(self._strangers) < _KEPT_SOURCES
            is_known = set(self._sessions) == self._names  # otherwise it may be a node that was not identified yet
            if is_new and is_known:
                self._strangers.add((sample.source, sample.key))
        if is_new and is_known:
            self._bus.worker(_WORKER).post(partial(self._on_stranger, sample))
        return False

    def _is_nodes(self, sample: Sample) -> bool:
        with self._changing:
            names = [name for name, session in self._sessions.items() if session == sample.source]
        return any(sample.is_sealed or name not in self._sealed for name in names)

    def _look_again(self) -> None:
        """Identify the nodes again: an unknown session may be a node that did not answer yet, or a second one."""
        with self._changing:
            is_due = time.monotonic() - self._asked_s > _AGAIN_S
            if is_due:
                self._asked_s = time.monotonic()
        if is_due and self._bus.worker(_WORKER).is_idle():
            for name in self._names:
                self._bus.worker(_WORKER).post(partial(self._learn, name))


@lru_cache(maxsize=256)
def topic_of(key: str) -> Topic | None:
    """Return the published topic of a key below the cell's root; None for a key that is not in the table."""
    return next((topic for pattern, topic in _PATTERNS if pattern.fullmatch(key)), None)


def strange(sample: Sample) -> Sample:
    """A stranger's sample as it is recorded: on a separate channel."""
    kept = Stranger(
        key=sample.key, encoding=sample.encoding, source=sample.source, payload=sample.payload[:_KEPT_BYTES]
    )
    return Sample(topics.STRANGER.key, encoding_of(Stranger), encode(kept))
