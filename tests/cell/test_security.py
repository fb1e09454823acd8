"""Who may do what beyond loopback: real certificates, real TLS, the files that `cell keys` writes."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest
import zenoh

from bus import topics
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest, HandMove, Nothing
from bus.errors import BadPayload, CellError, CellUnreachable, NoReply, Refused
from bus.frozen import Message
from bus.messages import HandState
from bus.sample import Asked, Sample
from bus.secured import session_config
from bus.session import Bus
from bus.topics import Topic
from cell.cli.network.tls_keys import ROLES, make_keys
from cell.client import Client
from tests.listeners import await_listeners

IDLE = CellState(state="Idle", stage="", cycle_id="", since_ns=1, available=("pick",), reason="")
HEALTHY = CellHealth(is_healthy=True, nodes={})
HAND = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the certificates and files of every role."""
    folder = tmp_path_factory.mktemp("keys")
    make_keys(folder, [])
    return folder


class Site(NamedTuple):
    """A cell that answers commands with their verb, its node, and what the cell heard and saw come and go."""

    join: Callable[..., Bus]
    cell: Bus
    heard: queue.SimpleQueue[Sample]
    leases: queue.SimpleQueue[tuple[str, bool]]


@pytest.fixture(scope="module", params=["direct", "router"])
def site(request: pytest.FixtureRequest, keys: Path, new_endpoint: Callable[[], str]) -> Iterator[Site]:
    """The cell listens for other machines itself, or meets them at a router."""
    door = new_endpoint().replace("tcp/", "tls/")
    with ExitStack() as stack:
        if request.param == "router":
            config = session_config("router", listen=[door], connect=None, file=keys / "router.json5")
            stack.enter_context(zenoh.open(config))
            beyond, router = None, door
        else:
            beyond, router = door, None
        security = keys / "cell.json5"
        cell = stack.enter_context(Bus.listen("test", new_endpoint(), beyond=beyond, router=router, security=security))
        site = Site(
            lambda role, cell_id="test": stack.enter_context(Bus.join(cell_id, door, security=keys / f"{role}.json5")),
            cell,
            queue.SimpleQueue(),
            queue.SimpleQueue(),
        )
        cell.answer(topics.STATE_NOW, lambda _payload, _fields: IDLE, worker="state")
        cell.answer(topics.HEALTH_NOW, lambda _payload, _fields: HEALTHY, worker="state")
        cell.answer(topics.COMMAND, _command, worker="command", verb="*")
        for topic in (topics.STATE, topics.HAND_STATE, topics.EVENT):
            cell.subscribe(topic.key, site.heard.put)
        cell.watch_alive(topics.LEASE, lambda name, is_alive: site.leases.put((name, is_alive)))
        node = site.join("node")
        node.answer(topics.HAND_NOW, lambda _payload, _fields: HAND, worker="hand")
        node.answer(topics.HAND_MOVE, lambda _payload, _fields: HAND, worker="hand")
        node.announce(topics.NODE_ALIVE, name="hand")
        yield site


@pytest.fixture(autouse=True)
def few_tries(monkeypatch: pytest.MonkeyPatch) -> None:
    """What nobody serves is asked again for a shorter time than by a user; each answer has all the time it needs."""
    monkeypatch.setattr("bus.asking._ROUTES_S", 0.2)


def _command(payload: bytes, asked: Asked) -> CommandReply:
    request = CommandRequest.model_validate_json(payload)
    if request.object == "gold":
        raise BadPayload("There is no gold.")
    return CommandReply(ok=True, state="Idle", reason=asked.verb)


def _is_answered(bus: Bus, topic: Topic, request: Message, **fields: str) -> bool:
    try:
        bus.ask(topic, request, timeout_s=5, **fields)
    except NoReply:
        return False
    return True


@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_who_looks_hears_and_asks_how_the_cell_is(site: Site, role: str) -> None:
    bus = site.join(role)
    heard: queue.SimpleQueue[Sample] = queue.SimpleQueue()
    bus.subscribe(topics.STATE.key, heard.put)
    assert bus.request(topics.STATE_NOW, Nothing(), CellState, timeout_s=60) == IDLE  # and the subscription is there
    assert bus.request(topics.HEALTH_NOW, Nothing(), CellHealth, timeout_s=60) == HEALTHY
    assert bus.alive(topics.NODE_ALIVE) == {"hand"}
    site.cell.publish(topics.STATE, IDLE)
    assert heard.get(timeout=60).key == "state"


@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_who_asks_for_another_cell_is_told_where_the_cells_are_listed(site: Site, role: str) -> None:
    with pytest.raises(NoReply, match=r"No cell 'elsewhere' answers here.*`cell fleet`.*cell_id"):
        Client(site.join(role, "elsewhere"), 5).state()


def test_a_viewer_may_stop_the_cell_as_anyone_may(site: Site) -> None:
    viewer = Client(site.join("viewer"), 5)
    for verb in ("stop", "abort", "hold", "suspend"):
        assert viewer.command(verb).reason == verb


def test_a_viewer_is_told_that_it_may_not_command(site: Site) -> None:
    viewer = Client(site.join("viewer"), 5)
    for verb in ("pick", "reset", "clear", "unhold"):
        with pytest.raises(Refused, match=r"does not reach it.*may look.*operator") as refusal:
            viewer.command(verb)
        assert (refusal.value.code, refusal.value.exit_code) == ("NO_RIGHT", 3)
    assert site.leases.empty(), "its token did not reach the cell either"


def test_an_operator_commands_and_holds_a_lease(site: Site) -> None:
    operator = Client(site.join("operator"), 5)
    assert operator.command("reset").reason == "reset"
    assert site.leases.get(timeout=60) == (operator.client_id, True)
    with pytest.raises(BadPayload, match="no gold"):  # an error's answer passes, too
        operator.command("pick", object_name="gold")
    with pytest.raises(NoReply, match=r"certificate.*operator\.json5.*may not"):
        site.join("operator").ask(topics.HAND_NOW, Nothing(), timeout_s=5)


@pytest.mark.parametrize("role", ["viewer", "operator", "node"])
def test_only_the_cell_asks_a_node(site: Site, role: str) -> None:
    assert site.cell.request(topics.HAND_MOVE, HandMove(width_m=0, speed_m_s=1), HandState, timeout_s=60) == HAND
    bus = site.join(role)
    assert not _is_answered(bus, topics.HAND_MOVE, HandMove(width_m=0.01, speed_m_s=0.1))


def test_a_node_speaks_for_its_devices_and_for_nothing_else(site: Site) -> None:
    node = site.join("node")
    await_listeners(node, topics.HAND_STATE)
    node.publish(topics.STATE, IDLE)
    node.announce(topics.LEASE, name="node")
    node.publish(topics.HAND_STATE, HAND)
    assert site.heard.get(timeout=60).key == "hand/state", "what came first was the cell's to say"
    assert not _is_answered(node, topics.COMMAND, CommandRequest(), verb="stop")
    assert site.leases.empty()


def test_nobody_else_speaks_for_the_cell(site: Site) -> None:
    for role in ("viewer", "operator"):
        bus = site.join(role)
        bus.publish(topics.STATE, IDLE)
        bus.publish(topics.HAND_STATE, HAND)
        bus.alive(topics.NODE_ALIVE)  # answered after both were sent
    site.cell.alive(topics.NODE_ALIVE)
    assert site.heard.empty()


def test_a_command_too_long_to_be_one_does_not_reach_the_cell(site: Site) -> None:
    request = CommandRequest.model_construct(command_id="x" * 100_000)
    assert not _is_answered(site.join("operator"), topics.COMMAND, request, verb="reset")


def test_without_a_certificate_of_ours_nobody_comes_in(site: Site, keys: Path, tmp_path: Path) -> None:
    make_keys(tmp_path, [])  # another authority's
    (tmp_path / "ca.pem").write_bytes((keys / "ca.pem").read_bytes())
    with pytest.raises(CellUnreachable, match="does not accept the certificate"):
        site.join(str(tmp_path / "operator"))


def test_a_keys_folder_keeps_its_authority_and_its_secrets(keys: Path, tmp_path: Path) -> None:
    make_keys(tmp_path, ["10.0.0.1", "cell.example"])
    authority = (tmp_path / "ca.pem").read_bytes()
    make_keys(tmp_path, ["10.0.0.2"])
    assert (tmp_path / "ca.pem").read_bytes() == authority
    assert {(tmp_path / f"{role}.key").stat().st_mode & 0o777 for role in (*ROLES, "ca")} == {0o600}
    with pytest.raises(CellError, match="committed"):
        make_keys(Path(__file__).parent / "keys", [])
    with pytest.raises(CellError, match="neither an address nor"):
        make_keys(tmp_path, ["käse!"])
