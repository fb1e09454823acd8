"""What a client hears of a cell's states, and that it does not wait for a cell that is gone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest

from bus import topics
from bus.clock import WALL_CLOCK
from bus.codec import encode
from bus.commands import CellState, CommandReply
from bus.errors import CellUnreachable, NoReply, Refused, ReplyTimeout
from bus.messages import CycleResult
from bus.sample import Sample
from bus.session import Bus
from bus.topics import Topic, encoding_of
from cell.client import Client
from cell.machine.leases import CELL_CLIENT
from tests.listeners import await_listeners

CELL, STRANGER = "cell's own session", "another session"


class ScriptedBus:
    """Answers with one state after the other, and lets the test put samples of others on the cell's keys."""

    cell, clock = CELL, WALL_CLOCK

    def __init__(self, *states: CellState) -> None:
        self._states = list(states)
        self._callbacks: dict[str, Callable[[Sample], None]] = {}

    def subscribe(self, pattern: str, callback: Callable[[Sample], None], *, in_order: bool) -> None:
        self._callbacks[pattern] = callback

    def watch_alive(self, _topic: Topic, callback: Callable[[str, bool], None]) -> None:
        self.comes_or_goes = callback

    def request(self, _topic: Topic, *_asked: Any, **_fields: Any) -> Any:
        if not self._states:
            raise ReplyTimeout("No answer in time.")
        return self._states.pop(0)

    def await_heard(self) -> None: ...

    def put(self, message: CellState | CycleResult, source: str) -> None:
        topic = topics.STATE if isinstance(message, CellState) else topics.RESULT
        self._callbacks[topic.key](Sample(topic.key, encoding_of(type(message)), encode(message), source))


def _state(name: str, since_ns: int = 1) -> CellState:
    return CellState(state=name, stage="", cycle_id="", since_ns=since_ns, available=(), reason="")


def test_what_is_heard_only_wakes_and_the_cell_is_asked_for_its_state() -> None:
    """Also when the wall clock has been set back meanwhile: no stamps are compared."""
    bus = ScriptedBus(_state("Holding", 5), _state("Holding", 5), _state("Held", 2))
    client = Client(cast(Bus, bus), 1.0)
    for _ in range(2):
        bus.put(_state("Held", 9), CELL)
    assert client.wait_for_state({"Held"}, 60).since_ns == 2


class BeginningBus(ScriptedBus):
    """A cell that begins: it hears of no command before it has told its state."""

    def request(self, _topic: Topic, *_asked: Any, **_fields: Any) -> Any:
        if _topic is topics.STATE_NOW:
            return self._states.pop(0)
        if self._states:
            raise NoReply("Nobody answers.")
        return CommandReply(ok=True, state="Resetting", available=())


def test_a_command_that_comes_as_the_cell_begins_is_sent_again() -> None:
    client = Client(cast(Bus, BeginningBus(_state("Stopped"))), 1.0)
    assert client.command("stop").ok


def test_a_command_that_a_cell_never_hears_of_is_a_matter_of_rights() -> None:
    client = Client(cast(Bus, BeginningBus(_state("Stopped"), _state("Stopped"))), 1.0)
    with pytest.raises(Refused) as refusal:
        client.command("stop")
    assert refusal.value.code == "NO_RIGHT"


def test_a_cell_that_is_gone_is_not_waited_for_and_not_called_busy_until_it_is_back() -> None:
    bus = ScriptedBus(_state("Idle"))
    client = Client(cast(Bus, bus), 1.0)
    bus.comes_or_goes(CELL_CLIENT, False)
    for ask in (client.state, client.health):
        with pytest.raises(CellUnreachable, match="The cell is gone"):
            ask()
    bus.comes_or_goes(CELL_CLIENT, True)
    assert client.state().state == "Idle"
    with pytest.raises(ReplyTimeout):
        client.command("stop")
    bus.comes_or_goes(CELL_CLIENT, False)
    with pytest.raises(CellUnreachable):
        client.command("stop")


def test_what_a_stranger_puts_on_the_cells_keys_is_not_heard() -> None:
    bus = ScriptedBus()
    client = Client(cast(Bus, bus), 1.0)
    forged = CycleResult(
        cycle_id="c", object="", result="SUCCESS", code=None, reason="", stages={}, wall_s=0.0, recording=""
    )
    for source in (STRANGER, ""):
        bus.put(forged, source)
        bus.put(_state("Idle"), source)
    assert list(client.heard()) == []
    bus.put(forged.model_copy(update={"reason": "the cell's"}), CELL)
    said = client.next_said(5.0)
    assert isinstance(said, CycleResult) and said.reason == "the cell's"


def test_what_the_cell_says_is_heard_in_the_order_in_which_it_said_it(endpoint: str) -> None:
    """So that who hears that a pick is complete has its result."""
    result = CycleResult(
        cycle_id="c", object="", result="SUCCESS", code=None, reason="", stages={}, wall_s=0.0, recording=""
    )
    with Bus.listen("test", endpoint) as cell, Bus.join("test", endpoint) as bus:
        client = Client(bus, 5.0)
        await_listeners(cell, topics.STATE, topics.RESULT)
        keys = []
        for number in range(200):
            cell.publish(topics.RESULT, result)
            cell.publish(topics.STATE, _state("Complete", number))
            for _ in range(2):
                heard = client.next_heard(60)
                assert heard is not None
                keys.append(heard.key)
        assert keys == ["cycle/result", "state"] * 200


def test_nobody_waits_for_a_cell_that_is_gone(endpoint: str) -> None:
    with Bus.listen("test", endpoint) as cell:
        cell.answer(topics.STATE_NOW, lambda _payload, _asked: _state("Resetting", 1), worker="state")
        cell.announce(topics.LEASE, name=CELL_CLIENT)
        with Bus.join("test", endpoint) as bus:
            client = Client(bus, 5.0)
            client.state()
            cell.close()
            wait: Callable[[], object]
            for wait in (lambda: client.next_said(600), lambda: client.wait_for_result("1", 600)):
                with pytest.raises(CellUnreachable, match="is gone"):
                    wait()


def test_who_asks_for_another_cell_is_told_that_it_is_not_the_one_here(endpoint: str) -> None:
    with Bus.listen("here", endpoint), Bus.join("elsewhere", endpoint) as bus:
        client = Client(bus, 5.0)
        with pytest.raises(CellUnreachable, match="cell 'elsewhere' does not answer at this address"):
            client.state()


class HurriedBus(ScriptedBus):
    """A bus on which nobody says in time who is there."""

    def request(self, _topic: Topic, *_asked: Any, **_fields: Any) -> Any:
        raise NoReply("Nobody answers 'state'.")

    def alive(self, _topic: Topic) -> set[str]:
        raise ReplyTimeout("'lease/*' got no answer within 1.0 s.")


def test_where_nobody_says_in_time_who_is_there_nothing_is_taken_for_another_cell() -> None:
    with pytest.raises(NoReply, match="Nobody answers 'state'"):
        Client(cast(Bus, HurriedBus()), 1.0).state()


def test_a_cell_that_is_there_and_does_not_answer_is_not_taken_for_another(endpoint: str) -> None:
    with Bus.listen("test", endpoint) as cell, Bus.join("test", endpoint) as bus:
        cell.announce(topics.LEASE, name=CELL_CLIENT)
        client = Client(bus, 5.0)
        with pytest.raises(NoReply, match="Nobody answers 'state'"):
            client.state()
