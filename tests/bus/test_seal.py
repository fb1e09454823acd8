"""Who shares the cell's secret is told from who only claims to be of its session."""

from __future__ import annotations

import json
import queue
from collections.abc import Callable

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from bus import topics
from bus.commands import ErrorReply, Heartbeat, Nothing
from bus.messages import HandState
from bus.sample import Asked, Sample
from bus.seal import Seal
from bus.session import Bus
from bus.topics import encoding_of
from tests.listeners import await_listeners

HAND = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)
KEY, SOURCE = "cell/test/hand/home", "ab12"


def _noting(acts: queue.SimpleQueue[bytes]) -> Callable[[bytes, Asked], HandState]:
    """A handler that puts what it is asked into ``acts``."""

    def home(payload: bytes, _asked: Asked) -> HandState:
        acts.put(payload)
        return HAND

    return home


@given(st.binary(max_size=64), st.binary(max_size=64), st.integers(0, 2**32 - 1))
def test_a_seal_fits_what_it_was_made_for_and_nothing_else(payload: bytes, other: bytes, number: int) -> None:
    seal = Seal.new()
    made = seal.of(KEY, SOURCE, number, payload)
    assert seal.fits(made, KEY, SOURCE, number, payload)
    assert not seal.fits(made, KEY, SOURCE, number + 1, payload)
    assert not seal.fits(made, KEY, "cd34", number, payload)
    assert not seal.fits(made, f"{KEY}s", SOURCE, number, payload)
    assert not Seal.new().fits(made, KEY, SOURCE, number, payload)
    assert not seal.fits(other, KEY, SOURCE, number, payload)
    assert seal.fits(made, KEY, SOURCE, number, other) is (payload == other)


def test_what_is_said_with_a_copied_source_or_a_copied_seal_moves_nothing(endpoint: str) -> None:
    """The stranger has heard the cell, and says of itself whatever the cell said of itself."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    acts: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    overheard: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    with Bus.listen("test", endpoint) as cell, Bus.join("test", endpoint) as node, zenoh.open(config) as stranger:
        node.seal = cell.seal
        node.answer(topics.HAND_HOME, _noting(acts), worker="hand")
        stranger.declare_subscriber("cell/test/heartbeat", overheard.put)
        cell.ask(topics.HAND_HOME, Nothing(), timeout_s=60)
        acts.get(timeout=60)
        while overheard.empty():
            cell.publish(topics.HEARTBEAT, Heartbeat())
            cell.alive(topics.NODE_ALIVE)
        copied = overheard.get()
        assert copied.source_info is not None and copied.attachment is not None
        for seal in (None, copied.attachment.to_bytes(), b"x" * 32):
            source = zenoh.SourceInfo(copied.source_info.source_id, copied.source_info.source_sn + 7)
            (reply,) = stranger.get(
                KEY, payload=b"{}", encoding=encoding_of(Nothing), source_info=source, attachment=seal, timeout=5.0
            )
            assert reply.err is not None
            assert ErrorReply.model_validate_json(reply.err.payload.to_bytes()).code == "NOT_THE_CELL"
        assert acts.empty()


@pytest.mark.parametrize("shares", [True, False])
def test_what_is_heard_says_whether_it_is_sealed(endpoint: str, shares: bool) -> None:
    heard: queue.SimpleQueue[Sample] = queue.SimpleQueue()
    with Bus.listen("test", endpoint) as cell, Bus.join("test", endpoint) as node:
        if shares:
            node.seal = cell.seal
        cell.subscribe("hand/state", heard.put)
        await_listeners(node, topics.HAND_STATE)
        node.publish(topics.HAND_STATE, HAND)
        said = heard.get(timeout=60)
        assert (said.source, said.is_sealed) == (node.source, shares)


def test_a_copy_of_a_sealed_question_is_not_carried_out_again(endpoint: str) -> None:
    """As somebody could send it who serves the same key, and so was asked it, too."""
    acts: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with Bus.listen("test", endpoint) as cell, Bus.join("test", endpoint) as node:
        node.seal = cell.seal
        node.answer(topics.HAND_HOME, _noting(acts), worker="hand")
        assert cell.seal is not None
        first = zenoh.SourceInfo(cell._session.id, 4_000_000)
        sealed = cell.seal.of(KEY, cell.source, 4_000_000, b"{}")

        def ask() -> zenoh.Reply:
            (reply,) = cell._session.get(
                KEY, payload=b"{}", encoding=encoding_of(Nothing), source_info=first, attachment=sealed, timeout=5.0
            )
            return reply

        cell.ask(topics.HAND_HOME, Nothing(), timeout_s=60)  # the route is there
        assert ask().ok is not None
        for _ in range(6):  # its answer is forgotten meanwhile
            cell.ask(topics.HAND_HOME, Nothing(), timeout_s=60)
        copy = ask()
        assert copy.err is not None
        assert ErrorReply.model_validate_json(copy.err.payload.to_bytes()).code == "REPEATED"
    assert acts.qsize() == 8
