"""What a client hears of a cell's states, and that it does not wait for a cell that is gone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest

from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.errors import CellUnreachable
from bus.heard import Heard
from bus.session import Bus
from bus.topics import Topic, encoding_of
from cell.client import Client
from cell.leases import CELL_CLIENT


class ScriptedBus:
    """Answers with one state, and lets the test say others."""

    def __init__(self, now: CellState) -> None:
        self._now = now
        self._callbacks: dict[str, Callable[[Heard], None]] = {}

    def subscribe(self, pattern: str, callback: Callable[[Heard], None]) -> None:
        self._callbacks[pattern] = callback

    def watch_alive(self, _topic: Topic, _callback: Callable[[str, bool], None]) -> None:
        """Nobody comes or goes."""

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


def test_nobody_waits_for_a_cell_that_is_gone(endpoint: str) -> None:
    with Bus.listen("test", endpoint) as cell:
        cell.answer(topics.STATE_NOW, lambda _payload, _fields: _state("Resetting", 1), lane="state")
        cell.announce(topics.LEASE, name=CELL_CLIENT)
        with Bus.join("test", endpoint) as bus:
            client = Client(bus, 5.0)
            client.state()
            cell.close()
            for wait in (lambda: client.next_result(600), lambda: client.wait_for_result("1", 600)):
                with pytest.raises(CellUnreachable, match="is gone"):
                    wait()
