"""What acts answers its exact key, with its own payload, for who may ask, once; and from one session only."""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Iterator

import pytest
import zenoh

from bus import topics
from bus.codec import bus_schema, encode
from bus.commands import CommandReply, CommandRequest, ErrorReply, HandMove, Nothing
from bus.errors import NoReply, Refused, TwoAnswers
from bus.messages import HandState
from bus.sample import Asked, Sample
from bus.session import Bus
from bus.topics import Topic, encoding_of
from tests.listeners import await_listeners

HAND = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)
ACTING = [topic for topic in topics.TOPICS if topic.acts]
FIELDS = {"verb": "reset", "part": "arm"}


class Site:
    """A cell, its node, and a stranger who speaks plain Zenoh; ``acts``: what was carried out."""

    def __init__(self, cell: Bus, node: Bus, stranger: zenoh.Session) -> None:
        self.cell, self.node, self.stranger = cell, node, stranger
        self.acts: queue.SimpleQueue[str] = queue.SimpleQueue()
        for topic in ACTING:
            fields = {name: "*" for name in FIELDS if f"{{{name}}}" in topic.key}
            (cell if topic.acts == "client" else node).answer(topic, self._act(topic), worker="acts", **fields)
        node.answer(topics.HAND_NOW, lambda _payload, _asked: HAND, worker="state")
        self.cell.request(topics.HAND_NOW, Nothing(), HandState, timeout_s=60)  # the routes are there

    def _act(self, topic: Topic):  # type: ignore[no-untyped-def]
        def act(_payload: bytes, _asked: Asked) -> HandState:
            self.acts.put(topic.key)
            return HAND

        return act

    def get(self, key: str, payload: bytes | None = None, encoding: str | None = None) -> list[zenoh.Reply]:
        return list(self.stranger.get(f"cell/test/{key}", payload=payload, encoding=encoding, timeout=5.0))


@pytest.fixture(scope="module")
def site(new_endpoint) -> Iterator[Site]:  # type: ignore[no-untyped-def]
    endpoint = new_endpoint()
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with Bus.listen("test", endpoint) as cell, Bus.join("test", endpoint) as node, zenoh.open(config) as stranger:
        yield Site(cell, node, stranger)


def _codes(replies: list[zenoh.Reply]) -> set[str]:
    """Of the refusals; "" for what was answered."""
    errors = [reply.err for reply in replies]
    return {"" if error is None else ErrorReply.model_validate_json(error.payload.to_bytes()).code for error in errors}


@pytest.mark.parametrize(
    "pattern", ["**", "*", "arm/*", "hand/h$*", "hand/*", "command/*", "camera/**", "*/stop", "sim/*", "fault/*"]
)
@pytest.mark.parametrize("payload", [None, b"{}"])
def test_a_pattern_moves_nothing_and_everything_that_acts_says_so(
    site: Site, pattern: str, payload: bytes | None
) -> None:
    codes = _codes(site.get(pattern, payload))
    assert codes <= {"EXACT_KEY", ""} and site.acts.empty()


def test_what_only_reads_answers_patterns_too(site: Site) -> None:
    (answer,) = site.get("hand/n$*")
    assert answer.ok is not None and str(answer.ok.key_expr) == "cell/test/hand/now"


@pytest.mark.parametrize("topic", ACTING, ids=lambda topic: topic.key)
def test_without_a_payload_nothing_acts(site: Site, topic: Topic) -> None:
    assert _codes(site.get(topic.key.format(**FIELDS))) <= {"NO_PAYLOAD", "NOT_THE_CELL"}
    assert site.acts.empty()


@pytest.mark.parametrize("topic", [topic for topic in ACTING if topic.acts == "cell"], ids=lambda topic: topic.key)
def test_a_device_acts_for_the_cells_own_session_only(site: Site, topic: Topic) -> None:
    encoding = encoding_of(topic.asks)
    assert _codes(site.get(topic.key, b"{}", encoding)) == {"NOT_THE_CELL"} and site.acts.empty()


def test_somebody_who_joins_as_we_do_is_still_not_the_cell(site: Site) -> None:
    with pytest.raises(Refused) as refusal:
        site.node.ask(topics.HAND_MOVE, HandMove(width_m=0.0, speed_m_s=0.1), timeout_s=60)
    assert refusal.value.code == "NOT_THE_CELL" and "command/VERB" in refusal.value.advice


def test_a_session_that_claims_to_be_another_is_not_the_cell(site: Site) -> None:
    publisher = site.stranger.declare_publisher("cell/test/x")
    claimed = zenoh.SourceInfo(publisher.id, 1)
    replies = site.stranger.get(
        "cell/test/hand/home", payload=b"{}", encoding=encoding_of(Nothing), source_info=claimed, timeout=5.0
    )
    assert _codes(list(replies)) == {"NOT_THE_CELL"} and site.acts.empty()


def test_the_cell_itself_is_obeyed(site: Site) -> None:
    site.cell.ask(topics.HAND_HOME, Nothing(), timeout_s=60)
    assert site.acts.get(timeout=60) == "hand/home"


@pytest.mark.parametrize("encoding", [None, "application/json", "zenoh/string", encoding_of(CommandRequest)])
def test_a_command_is_taken_from_any_program_that_sends_one(site: Site, encoding: str | None) -> None:
    assert _codes(site.get("command/reset", encode(CommandRequest()), encoding)) == {""}
    assert site.acts.get(timeout=60) == "command/{verb}"


def test_a_command_in_another_types_encoding_is_refused(site: Site) -> None:
    assert _codes(site.get("command/reset", b"{}", encoding_of(HandMove))) == {"WRONG_ENCODING"} and site.acts.empty()


@pytest.mark.parametrize("verb", ["\\1", "\\g<0>", "ä", "a b", "{verb}", "x" * 300])
def test_every_verb_is_answered(site: Site, verb: str) -> None:
    assert len(site.get(f"command/{verb}", b"{}")) == 1
    site.acts.get(timeout=60)


def test_the_same_question_asked_again_is_answered_again_and_acts_once(site: Site) -> None:
    source = zenoh.SourceInfo(site.cell._session.id, 77)
    for _ in range(3):
        (reply,) = site.cell._session.get(
            "cell/test/hand/home", payload=b"{}", encoding=encoding_of(Nothing), source_info=source, timeout=5.0
        )
        assert reply.ok is not None
    assert site.acts.get(timeout=60) == "hand/home" and site.acts.empty()


def test_a_refusal_has_one_shape(site: Site) -> None:
    replies = [*site.get("command/reset"), *site.get("hand/home"), *site.get("command/*", b"{}")]
    said = [json.loads(reply.err.payload.to_string()) for reply in replies if reply.err is not None]
    assert len(said) == 3
    for one in said:
        assert one["ok"] is False and one["code"] and one["reason"] and one["advice"]
        assert set(one) == set(ErrorReply.model_fields)
    shared = set(ErrorReply.model_fields) - {"error"}
    assert shared <= set(CommandReply.model_fields), "an answer of either kind is read alike"


# --- one session a name -----------------------------------------------------------------------------------------------


def _asked_until_both_are_known(site: Site) -> None:
    """Ask until it is an error: on a busy machine the other's queryable is known only after a while."""
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        site.cell.request(topics.HAND_NOW, Nothing(), HandState, timeout_s=60)


def test_an_answer_from_two_is_an_error_not_the_first_of_them(site: Site) -> None:
    other = site.stranger.declare_queryable(
        "cell/test/hand/now", lambda query: query.reply("cell/test/hand/now", encode(HAND))
    )
    try:
        with pytest.raises(TwoAnswers, match="2 sessions answer 'hand/now'"):
            _asked_until_both_are_known(site)
    finally:
        other.undeclare()  # type: ignore[no-untyped-call]
    assert site.cell.request(topics.HAND_NOW, Nothing(), HandState, timeout_s=60) == HAND


def test_who_serves_a_key_too_and_never_answers_is_noticed(site: Site) -> None:
    kept: list[zenoh.Query] = []
    other = site.stranger.declare_queryable("cell/test/hand/now", kept.append, complete=True)
    try:
        with pytest.raises(TwoAnswers, match="lets it wait"):
            _asked_until_both_are_known(site)
    finally:
        other.undeclare()  # type: ignore[no-untyped-call]


def test_what_is_heard_says_which_session_said_it(site: Site) -> None:
    heard: queue.SimpleQueue[Sample] = queue.SimpleQueue()
    site.cell.subscribe("hand/state", heard.put)
    await_listeners(site.node, topics.HAND_STATE)
    site.node.publish(topics.HAND_STATE, HAND)
    assert heard.get(timeout=60).source == site.node.source
    site.stranger.put("cell/test/hand/state", encode(HAND))
    assert heard.get(timeout=60).source == ""


def test_a_token_is_given_back(site: Site) -> None:
    changes: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
    site.cell.watch_alive(topics.LEASE, lambda name, is_alive: changes.put((name, is_alive)))
    site.node.announce(topics.LEASE, name="app")
    assert changes.get(timeout=60) == ("app", True)
    site.node.withdraw(topics.LEASE, name="app")
    site.node.withdraw(topics.LEASE, name="app")
    assert changes.get(timeout=60) == ("app", False)


def test_the_bus_describes_itself() -> None:
    schema = bus_schema()
    assert [row.key for row in schema.topics] == [topic.key for topic in topics.TOPICS]
    asked = {row.asks for row in schema.topics if row.asks}
    assert asked <= set(schema.json_schemas)
    assert "client_id" in schema.json_schemas[encoding_of(CommandRequest)]["properties"]


def test_nobody_there_is_still_its_own_error(site: Site) -> None:
    with pytest.raises(NoReply):
        site.cell.ask(topics.HEALTH_NOW, Nothing(), timeout_s=0.1)
