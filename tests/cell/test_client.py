"""What a client hears of a cell's states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.heard import Heard
from bus.session import Bus
from bus.topics import Topic, encoding_of
from cell.client import Client


class ScriptedBus:
    """Answers with one state, and lets the test say others."""

    def __init__(self, now: CellState) -> None:
        self._now = now
        self._callbacks: dict[str, Callable[[Heard], None]] = {}

    def subscribe(self, pattern: str, callback: Callable[[Heard], None]) -> None:
        self._callbacks[pattern] = callback

    def request(self, _topic: Topic, *_asked: Any, **_fields: Any) -> CellState:
        return self._now

    def say(self, state: CellState) -> None:
        self._callbacks[topics.STATE.key](Heard(topics.STATE.key, encoding_of(CellState), encode(state)))


def _state(name: str, since_ns: int) -> CellState:
    return CellState(state=name, stage="", cycle_id="", since_ns=since_ns, available=(), reason="")


def test_a_state_said_before_the_present_one_is_not_waited_for() -> None:
    bus = ScriptedBus(_state("Holding", 5))
    client = Client(cast(Bus, bus), 1.0)
    for name, since_ns in (("Held", 2), ("Execute", 4), ("Holding", 5), ("Held", 6)):
        bus.say(_state(name, since_ns))
    assert client.wait_for_state({"Held"}, 5.0).since_ns == 6
