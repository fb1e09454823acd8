"""A node's link that is off, stuck, garbled, wrong or slow; and that stops come through it all the same."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from bus import topics
from bus.codec import decode
from bus.commands import Event, Nothing
from bus.errors import BadPayload, BusError, NoReply, ReplyTimeout
from bus.fault_injection import Fault, FaultRequest
from bus.faulty_bus import FaultyBus, answer_faults
from bus.frozen import Message
from bus.messages import HandState
from bus.sample import Asked, Sample
from bus.session import Bus

HAND = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)
NO_ANSWER_S = 0.3
"""After this there is none."""


class Bench:
    """A cell, and a node on a link that can be spoiled; it answers for the hand and counts the arm's stops."""

    def __init__(self, cell: Bus, node: FaultyBus) -> None:
        self.cell, self.node = cell, node
        self.stops = threading.Semaphore(0)
        self.said: list[Message] = []
        node.answer(topics.HAND_NOW, lambda payload, fields: HAND, worker="state")
        node.answer(topics.ARM_STOP, self._stop, worker="arm-stop")
        answer_faults(node, {"bus": node}, lambda topic, message: self.said.append(message))

    def _stop(self, payload: bytes, _: Asked) -> Message:
        self.stops.release()
        return Nothing()

    def set(self, fault: Fault, delay_s: float | None = None) -> None:
        self.cell.ask(topics.FAULT, FaultRequest(fault=fault, delay_s=delay_s), timeout_s=60, part="bus")

    def hand(self, timeout_s: float = 60.0) -> HandState:
        return self.cell.request(topics.HAND_NOW, Nothing(), HandState, timeout_s=timeout_s)

    def stop(self, timeout_s: float = 60.0) -> None:
        self.cell.ask(topics.ARM_STOP, Nothing(), timeout_s=timeout_s)


@pytest.fixture
def bench(endpoint: str) -> Iterator[Bench]:
    with Bus.listen("test", endpoint) as cell, FaultyBus.join("test", endpoint) as node:
        assert isinstance(node, FaultyBus)
        yield Bench(cell, node)


def test_a_link_without_a_fault_is_a_link(bench: Bench) -> None:
    assert bench.hand() == HAND
    bench.stop()
    assert bench.stops.acquire(timeout=60)


def test_a_link_that_is_off_is_cut_after_it_said_so(bench: Bench) -> None:
    bench.set(Fault.OFF)
    give_up_s = time.monotonic() + 60
    with pytest.raises(NoReply):  # the cut follows the answer
        while time.monotonic() < give_up_s:
            bench.hand()
    with pytest.raises(BusError):
        bench.node.publish(topics.HAND_STATE, HAND)


def test_an_event_says_which_fault_was_set_and_that_it_has_ended(bench: Bench) -> None:
    bench.set(Fault.SLOW, delay_s=0.0)
    bench.set(Fault.NONE)
    begun, ended = bench.said
    assert isinstance(begun, Event) and isinstance(ended, Event)
    assert (begun.severity, begun.text) == ("warning", "Injected fault of the bus: slow.")
    assert (ended.severity, ended.text, ended.advice) == ("info", "The injected fault of the bus has ended.", "")


def test_a_stuck_link_answers_nothing_but_a_stop_is_carried_out(bench: Bench) -> None:
    bench.set(Fault.STUCK)
    for _ in range(2):  # nor does the first keep the second from it
        with pytest.raises(ReplyTimeout):
            bench.stop(NO_ANSWER_S)
        assert bench.stops.acquire(timeout=60)
    with pytest.raises(ReplyTimeout):
        bench.hand(NO_ANSWER_S)
    bench.set(Fault.NONE)
    assert bench.hand() == HAND


@pytest.mark.parametrize("fault", [Fault.GARBAGE, Fault.WRONG])
def test_a_garbled_or_wrong_link_says_what_cannot_be_read(bench: Bench, fault: Fault) -> None:
    heard: list[Sample] = []
    arrived = threading.Event()

    def hear(one: Sample) -> None:
        heard.append(one)
        arrived.set()

    bench.cell.subscribe(topics.HAND_STATE.key, hear)
    bench.hand()  # the subscription has arrived
    bench.set(fault)
    with pytest.raises(BadPayload):
        bench.hand()
    bench.node.publish(topics.HAND_STATE, HAND)
    assert arrived.wait(60)
    with pytest.raises(BadPayload):
        decode(HandState, heard[-1].payload)
    bench.stop()
    assert bench.stops.acquire(timeout=60)


def test_a_slow_link_is_late_but_a_stop_is_carried_out_at_once(bench: Bench) -> None:
    bench.set(Fault.SLOW, 1.0)
    started_s = time.monotonic()
    assert bench.hand() == HAND
    assert time.monotonic() - started_s >= 1.0
    bench.set(Fault.SLOW, 3600.0)
    stopping = threading.Thread(target=bench.stop)
    stopping.start()
    assert bench.stops.acquire(timeout=60)
    bench.set(Fault.NONE)
    stopping.join()


def test_every_fault_that_is_set_is_said_and_a_time_that_is_none_refused(bench: Bench) -> None:
    with pytest.raises(BadPayload, match="delay_s"):
        bench.set(Fault.SLOW, float("nan"))
    assert bench.said == [] and bench.node.fault is Fault.NONE
    bench.set(Fault.GARBAGE)
    assert "bus: garbage" in str(bench.said[0])
