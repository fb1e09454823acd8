"""What a stranger puts on the cell's keys is told apart from what its nodes say, and recorded apart."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator

import pytest

from bus import topics
from bus.codec import decode
from bus.commands import Health, Stranger
from bus.messages import HandState
from bus.sample import Sample
from bus.session import Bus
from bus.topics import encoding_of
from cell.nodes.speakers import Speakers, strange, topic_of

HAND = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)
HEALTH = Health(name="sim", pid=17, uptime_s=1.0, answered=0, failed=0)


class Site:
    """A cell that hears what is published on its keys, sorted by whose it is."""

    def __init__(self, cell: Bus) -> None:
        self.cell = cell
        self.twice: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self.strangers: queue.SimpleQueue[Sample] = queue.SimpleQueue()
        self.heard: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self.speakers = Speakers(cell, {"sim"}, lambda *said: self.twice.put(said), self.strangers.put)
        self.speakers.listen()
        for topic in (topics.HAND_STATE, topics.RESULT, topics.EVENT):
            cell.subscribe(topic.key, lambda heard: self.heard.put((heard.key, self.speakers.is_ours(heard))))

    def settle(self, say: Callable[[], None]) -> None:
        """Say something until it is believed: the node's session is learned by then."""
        give_up_s = time.monotonic() + 60
        while True:
            assert time.monotonic() < give_up_s
            say()
            if self.heard.get(timeout=60)[1]:
                return
            time.sleep(0.02)


@pytest.fixture
def site(endpoint: str) -> Iterator[Site]:
    with Bus.listen("test", endpoint) as cell:
        yield Site(cell)


def _node(site: Site, bus: Bus) -> None:
    bus.answer(topics.NODE_NOW, lambda _payload, _asked: HEALTH, worker="state", name="sim")
    bus.announce(topics.NODE_ALIVE, name="sim")
    site.settle(lambda: bus.publish(topics.HAND_STATE, HAND))


def test_a_nodes_streams_are_its_own_and_nobody_elses(site: Site, endpoint: str) -> None:
    with Bus.join("test", endpoint) as node, Bus.join("test", endpoint) as stranger:
        _node(site, node)
        stranger.publish(topics.HAND_STATE, HAND)
        assert site.heard.get(timeout=60) == ("hand/state", False)
        heard = site.strangers.get(timeout=60)
        assert (heard.key, heard.source) == ("hand/state", stranger.source)
        node.publish(topics.EVENT, b"{}")
        assert site.heard.get(timeout=60) == ("event", True)


@pytest.mark.parametrize("who", ["node", "stranger"])
def test_nobody_else_says_how_a_cycle_ended(site: Site, endpoint: str, who: str) -> None:
    with Bus.join("test", endpoint) as node, Bus.join("test", endpoint) as stranger:
        _node(site, node)
        (node if who == "node" else stranger).publish(topics.RESULT, b"{}")
        assert site.heard.get(timeout=60) == ("cycle/result", False)
        assert site.strangers.get(timeout=60).key == "cycle/result"


def test_a_second_session_that_answers_for_a_node_is_noticed(site: Site, endpoint: str) -> None:
    with Bus.join("test", endpoint) as node, Bus.join("test", endpoint) as other:
        _node(site, node)
        other.answer(topics.NODE_NOW, lambda _payload, _asked: HEALTH, worker="state", name="sim")
        give_up_s = time.monotonic() + 60
        while site.twice.empty():
            assert time.monotonic() < give_up_s
            other.publish(topics.HAND_STATE, HAND)
            assert site.heard.get(timeout=60) == ("hand/state", False)
            time.sleep(0.05)
    assert site.twice.get() == ("sim", "process 17 and process 17")


def test_what_a_stranger_says_is_recorded_whole_as_far_as_it_goes_and_on_a_channel_of_its_own() -> None:
    heard = Sample("cycle/capture", "text/plain", b"x" * 100_000, "abc")
    kept = strange(heard)
    assert (kept.key, kept.encoding) == ("stranger", encoding_of(Stranger))
    said = decode(Stranger, kept.payload)
    assert (said.key, said.encoding, said.source, len(said.payload)) == ("cycle/capture", "text/plain", "abc", 65536)


def test_every_published_key_is_found_in_the_table() -> None:
    for topic in topics.TOPICS:
        if topic.kind == "publish":
            assert topic_of(topic.key.format(name="a-name")) is topic
    assert topic_of("cycle/nothing") is None and topic_of("node/a/b/health") is None
