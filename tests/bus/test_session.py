"""Two processes' worth of sessions on a real Zenoh: publish, ask, answer, be alive, fail clearly."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from bus import topics
from bus.asking import tokens_on
from bus.clock import WALL_CLOCK
from bus.codec import encode
from bus.commands import CommandReply, CommandRequest, Nothing
from bus.errors import (
    BadPayload,
    BusError,
    CellError,
    CellUnreachable,
    HandFault,
    NoReply,
    PortOccupied,
    Refused,
    ReplyTimeout,
)
from bus.messages import HandState
from bus.sample import Asked, Sample
from bus.session import Bus
from stand_ins.starved import StarvedMachine
from tests.listeners import await_listeners

HAND = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)


@pytest.fixture
def cell(endpoint: str) -> Iterator[Bus]:
    with Bus.listen("test", endpoint) as bus:
        yield bus


@pytest.fixture
def client(cell: Bus, endpoint: str) -> Iterator[Bus]:
    with Bus.join("test", endpoint) as bus:
        yield bus


def test_what_is_published_is_heard_with_its_encoding(cell: Bus, client: Bus) -> None:
    heard: queue.SimpleQueue[Sample] = queue.SimpleQueue()
    cell.subscribe("hand/*", heard.put)
    await_listeners(client, topics.HAND_STATE)
    client.publish(topics.HAND_STATE, HAND)
    got = heard.get(timeout=60)
    assert got.key == "hand/state" and got.encoding == "application/json;vlad.HandState"
    assert HandState.model_validate_json(got.payload) == HAND


def test_who_hears_in_order_hears_no_sample_before_what_was_said_first_is_done(cell: Bus, client: Bus) -> None:
    """Zenoh has a thread for each subscription."""
    heard: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
    second = threading.Event()

    def hear_first(sample: Sample) -> None:
        heard.put((sample.key, second.wait(0.2)))

    def hear_second(sample: Sample) -> None:
        second.set()
        heard.put((sample.key, True))

    client.subscribe(topics.RESULT.key, hear_first, in_order=True)
    client.subscribe(topics.STATE.key, hear_second, in_order=True)
    await_listeners(cell, topics.RESULT, topics.STATE)
    for topic in (topics.RESULT, topics.STATE):
        cell.publish(topic, b"{}")
    assert [heard.get(timeout=60) for _ in range(2)] == [("cycle/result", False), ("state", True)]


def test_what_was_said_before_an_answer_can_be_waited_for(cell: Bus, client: Bus) -> None:
    heard: queue.SimpleQueue[str] = queue.SimpleQueue()
    client.subscribe(topics.RESULT.key, lambda sample: heard.put(sample.key), in_order=True)
    await_listeners(cell, topics.RESULT)
    is_busy, go_on = threading.Event(), threading.Event()

    def stay_busy() -> None:
        is_busy.set()
        go_on.wait(60)

    client.worker("hearing").post(stay_busy)
    assert is_busy.wait(60)

    def answer(_payload: bytes, _asked: Asked) -> HandState:
        cell.publish(topics.RESULT, b"{}")
        return HAND

    cell.answer(topics.HAND_NOW, answer, worker="hand")
    assert client.request(topics.HAND_NOW, Nothing(), HandState, timeout_s=60) == HAND
    assert heard.empty(), "the answer was here first"
    threading.Timer(0.05, go_on.set).start()
    client.await_heard()
    assert heard.get_nowait() == "cycle/result"


def test_a_question_is_answered(cell: Bus, client: Bus) -> None:
    client.answer(topics.HAND_NOW, lambda _payload, _fields: HAND, worker="hand")
    assert cell.request(topics.HAND_NOW, Nothing(), HandState, timeout_s=60) == HAND


def test_the_verb_of_a_command_reaches_the_handler(cell: Bus, client: Bus) -> None:
    def handle(_payload: bytes, asked: Asked) -> CommandReply:
        return CommandReply(ok=True, state=asked.verb)

    cell.answer(topics.COMMAND, handle, worker="command", verb="*")
    reply = client.request(topics.COMMAND, CommandRequest(), CommandReply, timeout_s=60, verb="pick")
    assert reply.state == "pick"


@pytest.mark.parametrize(
    "error",
    [
        HandFault("The fingers are stuck.", "Free them."),
        Refused("No.", "Reset first.", code="WRONG_STATE", available=("reset",)),
        BadPayload("No such field."),
    ],
)
def test_an_error_travels_as_its_own_type(cell: Bus, client: Bus, error: CellError) -> None:
    def fail(_payload: bytes, _asked: Asked) -> HandState:
        raise error

    client.answer(topics.HAND_HOME, fail, worker="hand")
    with pytest.raises(type(error)) as caught:
        cell.ask(topics.HAND_HOME, Nothing(), timeout_s=60)
    assert (caught.value.text, caught.value.advice, caught.value.code) == (error.text, error.advice, error.code)
    if isinstance(error, Refused):
        assert isinstance(caught.value, Refused) and caught.value.available == ("reset",)


def test_a_defect_in_a_handler_reaches_the_asker(cell: Bus, client: Bus) -> None:
    def broken(_payload: bytes, _asked: Asked) -> HandState:
        raise ZeroDivisionError("oops")

    client.answer(topics.HAND_HOME, broken, worker="hand")
    with pytest.raises(CellError, match="ZeroDivisionError: oops"):
        cell.ask(topics.HAND_HOME, Nothing(), timeout_s=60)


def test_a_question_nobody_serves_is_its_own_error(cell: Bus) -> None:
    with pytest.raises(NoReply, match="hand/now"):
        cell.ask(topics.HAND_NOW, Nothing(), timeout_s=0.1)


def test_an_answer_that_does_not_come_is_a_timeout(cell: Bus, client: Bus) -> None:
    release = threading.Event()

    def slow(_payload: bytes, _asked: Asked) -> HandState:
        release.wait(60)
        return HAND

    client.answer(topics.HAND_HOME, slow, worker="hand")
    with pytest.raises(ReplyTimeout):
        cell.ask(topics.HAND_HOME, Nothing(), timeout_s=0.3)
    release.set()


@contextmanager
def asked(cell: Bus, node: Bus) -> Iterator[tuple[StarvedMachine, Future[list[Sample]], threading.Event]]:
    """A question with a timeout of 1 s that has reached its node, and what lets its answer come."""
    machine, arrived, release = StarvedMachine(), threading.Event(), threading.Event()
    cell.clock = machine.clock

    def home(_payload: bytes, _asked: Asked) -> HandState:
        arrived.set()
        release.wait(60)
        return HAND

    node.answer(topics.HAND_HOME, home, worker="hand")
    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(cell.ask, topics.HAND_HOME, Nothing(), timeout_s=1.0)
        assert arrived.wait(60)
        machine.await_looks(5)
        try:
            yield machine, asking, release
        finally:
            release.set()


def test_in_a_simulation_an_answer_is_waited_for_as_long_as_the_machine_is_busy(cell: Bus, client: Bus) -> None:
    with asked(cell, client) as (machine, asking, release):
        machine.passes(9.0)
        machine.await_looks(5)
        release.set()
        (answer,) = asking.result(10)
    assert answer.payload == encode(HAND)


def test_one_that_is_later_than_that_is_a_timeout_that_says_how_busy(cell: Bus, client: Bus) -> None:
    with asked(cell, client) as (machine, asking, _):
        machine.passes(11.0)
        with pytest.raises(ReplyTimeout, match=r"This machine is too busy: load 14\.0 on 2 cores.*takes 10 s"):
            asking.result(10)
    client.answer(topics.HAND_NOW, lambda _payload, _asked: HAND, worker="state")
    assert cell.request(topics.HAND_NOW, Nothing(), HandState, timeout_s=1.0) == HAND, "what was given up is forgotten"


def test_a_node_that_dies_ends_the_wait_whatever_the_patience(cell: Bus, endpoint: str) -> None:
    with Bus.join("test", endpoint) as node, asked(cell, node) as (machine, asking, _):
        node.announce(topics.NODE_ALIVE, name="hand")
        while not cell.alive(topics.NODE_ALIVE):
            pass
        node.close()
        while cell.alive(topics.NODE_ALIVE):
            pass
        while not wait([asking], timeout=0.005).done:  # it asks again for as long as a node's routes may take
            machine.passes(0.1)
        with pytest.raises(NoReply):
            asking.result()


def test_questions_and_answers_are_tapped(cell: Bus, client: Bus) -> None:
    tapped: list[Sample] = []
    cell.tap = tapped.append
    client.answer(topics.HAND_HOME, lambda _payload, _fields: HAND, worker="hand")
    cell.ask(topics.HAND_HOME, Nothing(), timeout_s=60)
    assert [one.key for one in tapped] == ["hand/home/query", "hand/home/reply"]


def test_nodes_come_and_go(cell: Bus, endpoint: str) -> None:
    changes: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
    cell.watch_alive(topics.NODE_ALIVE, lambda name, is_alive: changes.put((name, is_alive)))
    with Bus.join("test", endpoint) as node:
        node.announce(topics.NODE_ALIVE, name="camera")
        assert changes.get(timeout=60) == ("camera", True)
        assert cell.alive(topics.NODE_ALIVE) == {"camera"}
    assert changes.get(timeout=60) == ("camera", False)
    assert cell.alive(topics.NODE_ALIVE) == set()


class Late:
    """A Zenoh session whose question for tokens is over before all are known; ``says``: what it is answered with."""

    def __init__(self, *says: object) -> None:
        self._says = says

    def liveliness(self) -> Late:
        return self

    def get(self, _key: str, found: zenoh.handlers.Callback[Any], timeout: float) -> None:
        for one in self._says:
            found(one)
        cast(Any, found).drop()


def test_who_is_there_is_not_known_where_nobody_says_so_in_time() -> None:
    """And not that nobody is there: a second node would serve the same name, a cell be called another's."""
    known = SimpleNamespace(ok=SimpleNamespace(key_expr="cell/test/node/camera/alive"))
    with pytest.raises(ReplyTimeout, match=r"'node/\*/alive' got no answer within 1\.0 s"):
        tokens_on(cast(Any, Late(known, SimpleNamespace(ok=None))), "cell/test/node/*/alive", 1.0, WALL_CLOCK)
    assert tokens_on(cast(Any, Late(known)), "cell/test/node/*/alive", 1.0, WALL_CLOCK) == [known]


def test_in_a_simulation_it_is_not_known_either() -> None:
    machine = StarvedMachine()

    class Silent(Late):
        def get(self, _key: str, found: zenoh.handlers.Callback[Any], timeout: float) -> None:
            """Nobody says anything."""

    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(tokens_on, cast(Any, Silent()), "cell/test/node/*/alive", 1.0, machine.clock)
        while not wait([asking], timeout=0.005).done:
            machine.passes(1.0)
        with pytest.raises(ReplyTimeout):
            asking.result()


def test_an_occupied_port_says_so(cell: Bus, endpoint: str) -> None:
    with pytest.raises(PortOccupied, match=r"another program.*cell status"):
        Bus.listen("other", endpoint)


def test_an_absent_cell_says_so(endpoint: str) -> None:
    with pytest.raises(CellUnreachable, match="cell start"):
        Bus.join("test", endpoint)


def test_a_closed_bus_refuses_and_closes_twice(endpoint: str) -> None:
    bus = Bus.listen("test", endpoint)
    bus.close()
    bus.close()
    for use in (
        lambda: bus.publish(topics.HAND_STATE, HAND),
        lambda: bus.put("cell/test/hand/state", b"", "text/plain"),
        lambda: bus.ask(topics.HAND_NOW, Nothing(), timeout_s=1),
        lambda: bus.subscribe("hand/*", print),
        lambda: bus.answer(topics.HAND_NOW, lambda payload, question: HAND, worker="hand"),
        lambda: bus.announce(topics.LEASE, name="a"),
        lambda: bus.alive(topics.LEASE),
        lambda: bus.watch_alive(topics.LEASE, print),
        lambda: bus.is_heard("cell/test/hand/state"),
        lambda: bus.sessions(topics.HAND_NOW, timeout_s=1),
    ):
        with pytest.raises(BusError, match=r"(?i)this connection is closed\. Open a new one\."):
            use()
    bus.withdraw(topics.LEASE, name="a")
