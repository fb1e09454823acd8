"""The OPC UA door with a plain client: states, commands and their refusals, arguments, results, leases."""

from __future__ import annotations

import asyncio
import json
import os
import random
import socket
import struct
import sys
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np
import pytest

pytest.importorskip("asyncua")  # the extra `opcua`

from asyncua import Client, ua

from bus import topics
from bus.codes import Code
from bus.commands import Event
from bus.errors import ConfigError
from bus.messages import CycleResult, Job, Place, Proposal, Target
from cell.machine.leases import CELL_CLIENT
from cell.machine.states import COMMANDS, State
from cell.opcua import packml
from cell.opcua.methods import METHODS
from cell.opcua.variables import VARIABLES
from config.load import load_station
from docs import opcua_page
from docs.examples.opcua_client import pick
from tests.cell.opcua_bench import PICTURE, Plain, ScriptedCell, connected, serving, talk

pytestmark = pytest.mark.xdist_group("opcua")

RESULT = CycleResult(cycle_id="c1", object="cup", result="FAILED", code=Code.GRASP_MISSED, reason="Closed on nothing.",
                     stages={}, wall_s=2.0, recording="c1.mcap", job=Job(job_id="j1"))  # fmt: skip
COMMANDED = [method for method in METHODS if method.verb in COMMANDS]


SESSION_S, AT_ONCE_S = 60, 30
"""How long a session lives whose client is silent; what ends long before is not waiting for that."""


class Site(NamedTuple):
    """A scripted cell, and where its door listens."""

    cell: ScriptedCell
    endpoint: str


@pytest.fixture(scope="module")
def _site(new_endpoint: Callable[[], str]) -> Iterator[Site]:
    bus, door = new_endpoint(), new_endpoint().replace("tcp/", "opc.tcp://")
    cell = ScriptedCell(bus)
    settings = [f"bus.endpoint={bus}", f"opcua.endpoint={door}/cell", f"opcua.session_timeout_s={SESSION_S}"]
    with serving(load_station(None, settings)) as endpoint:
        yield Site(cell, endpoint)
    cell.bus.close()


@pytest.fixture
def site(_site: Site) -> Site:
    """Stopped, nobody holds the lease, nothing was commanded."""
    _site.cell.goes_on.set()
    give_up_s = time.monotonic() + 30
    while _site.cell.leases.holder:
        assert time.monotonic() < give_up_s
        time.sleep(0.01)
    while not _site.cell.lost.empty():
        _site.cell.lost.get()
    _site.cell.commands.clear()
    while _site.cell.arrived.acquire(blocking=False):
        pass
    _site.cell.enter(State.STOPPED)
    return _site


def arguments(name: str) -> list[Any]:
    """Arguments that a method takes."""
    given = {"Pick": ["", "", ""], "PickJob": [""], "Run": [ua.Variant(1, ua.VariantType.UInt32), False, ""]}
    return given.get(name, [])


# --- states and commands ----------------------------------------------------------------------------------------------


def test_each_of_the_states_is_shown_with_packmls_number(site: Site) -> None:
    async def say(plain: Plain) -> None:
        for state, node in packml.STATES.items():
            site.cell.enter(state)
            await plain.until("Status.StateCurrent", node.number)
            assert await plain.read("Status.StateName") == state
            where = await plain.read(f"{node.machine}.CurrentState.Id")
            number = await plain.client.get_node(where).get_child("0:StateNumber")
            assert await number.read_value() == node.number
            shown = {name: (await plain.read(f"{name}.CurrentState")).Text for name in packml.MACHINE_TYPES}
            assert shown == packml.current_states(state)

    assert set(packml.STATES) == set(State)
    talk(site.endpoint, say)


def test_every_command_is_refused_where_the_table_says_so(site: Site) -> None:
    async def say(plain: Plain) -> None:
        for state in State:
            site.cell.enter(state)
            for method in COMMANDED:
                status = await plain.status(method.name, *arguments(method.name))
                expected = "Good" if state in COMMANDS[method.verb] else "BadInvalidState"
                assert (state, method.name, status) == (state, method.name, expected)
        assert await plain.read("LastRefusal.Code") == "WRONG_STATE"

    talk(site.endpoint, say)
    accepted = [verb for verb, _ in site.cell.commands]
    assert len(accepted) == sum(len(COMMANDS[method.verb]) for method in COMMANDED)


def test_a_refusal_says_why_on_the_wire_in_variables_and_as_an_event(site: Site) -> None:
    async def say(plain: Plain) -> None:
        heard = await _events(plain)
        result = await plain.raw("Pick", "", "", "")
        code, words = (one.Value for one in result.OutputArguments)
        assert (result.StatusCode.name, code) == ("BadInvalidState", "WRONG_STATE")
        assert "not possible while the cell is Stopped" in words and "Reset the cell first" in words
        assert await plain.read("LastRefusal.Method") == "Pick"
        assert (await plain.read("LastRefusal.Client")).startswith("opcua-")
        assert await plain.read("LastRefusal.Reason") in words
        event = await asyncio.wait_for(heard.get(), 30)
        assert (event.Code, event.Method) == ("WRONG_STATE", "Pick")

    talk(site.endpoint, say)


def test_methods_are_found_where_the_specification_has_them(site: Site) -> None:
    async def say(plain: Plain) -> None:
        index = await plain.client.get_namespace_index(packml.NAMESPACE)
        cell = plain.node()
        for name, (machine, node) in packml.METHODS.items():
            on = plain.node(machine)
            assert await on.get_child(f"{index}:{name}") == plain.node(name)
            for where, method in ((cell, plain.node(name).nodeid), (on, ua.NodeId(node, index))):
                with suppress(ua.uaerrors.BadInvalidState):
                    await where.call_method(method)

    talk(site.endpoint, say)
    assert [verb for verb, _ in site.cell.commands] == ["abort", "abort", "reset", "reset"]


# --- arguments and jobs -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "given", "status", "code"),
    [
        ("Pick", [], "BadArgumentsMissing", "ARGUMENT_MISSING"),
        ("Pick", ["", "", "", ""], "BadTooManyArguments", "ARGUMENT_TOO_MANY"),
        ("Pick", ["", 1, ""], "BadInvalidArgument", "BAD_ARGUMENT"),
        ("Pick", ["", ["a", "b"], ""], "BadInvalidArgument", "BAD_ARGUMENT"),
        ("Pick", [b"red", "", ""], "BadInvalidArgument", "BAD_ARGUMENT"),
        ("Pick", ["x" * 70_000, "", ""], "BadInvalidArgument", "BAD_ARGUMENT"),
        ("Pick", ["x" * 300, "", ""], "BadInvalidArgument", "BAD_JOB"),
        ("Pick", ['{"pixel": [1]}', "", ""], "BadInvalidArgument", "BAD_JOB"),
        ("Pick", ["", '{"position_m": [99, 0, 0]}', ""], "BadInvalidArgument", "BAD_JOB"),
        ("PickJob", ["no JSON"], "BadInvalidArgument", "BAD_JOB"),
        ("PickJob", ['{"colour": "red"}'], "BadInvalidArgument", "BAD_JOB"),
        ("Run", [1, False, ""], "BadInvalidArgument", "BAD_ARGUMENT"),
        ("Run", [ua.Variant(0, ua.VariantType.UInt32), False, ""], "BadInvalidArgument", "BAD_JOB"),
        ("Stop", [True], "BadTooManyArguments", "ARGUMENT_TOO_MANY"),
    ],
)
def test_arguments_are_checked_before_the_cell_hears_of_them(
    site: Site, method: str, given: list[Any], status: str, code: str
) -> None:
    async def say(plain: Plain) -> None:
        result = await plain.raw(method, *given)
        assert (result.StatusCode.name, result.OutputArguments[0].Value) == (status, code)

    site.cell.enter(State.IDLE)
    talk(site.endpoint, say)
    assert site.cell.commands == []


def test_a_job_reaches_the_cell_whole_and_its_answer_the_client(site: Site) -> None:
    job = Job(job_id="mine", target=Target(pixel=(640, 360)), clear_way=True, queue=True)

    async def say(plain: Plain) -> None:
        assert await plain.call("Pick", "the red one", "left", "j1") == ["c1", "j1", 0]
        at = '{"position_m": [0.4, 0.4, 0.2], "yaw_rad": 1.0}'
        assert await plain.call("Pick", '{"point_m": [0.5, 0.0, 0.1]}', at, "") == ["c1", "c1", 0]
        assert await plain.call("PickJob", job.model_dump_json()) == ["c1", "mine", 2]
        await plain.call("Run", ua.Variant(3, ua.VariantType.UInt32), False, "")
        await plain.call("Run", ua.Variant(0, ua.VariantType.UInt32), True, "")
        assert await plain.call("Cancel", "mine") is None

    site.cell.enter(State.IDLE)
    talk(site.endpoint, say)
    sent = [request for _, request in site.cell.commands]
    assert sent[0].job == Job(job_id="j1", target=Target(text="the red one"), place=Place(name="left"))
    assert sent[1].job.target == Target(point_m=(0.5, 0.0, 0.1))
    assert sent[1].job.place == Place(position_m=(0.4, 0.4, 0.2), yaw_rad=1.0)
    assert sent[2].job == job
    assert [(one.cycles, one.until_empty) for one in sent[3:5]] == [(3, False), (1, True)]
    assert (site.cell.commands[5][0], sent[5].job.job_id) == ("cancel", "mine")


# --- results, events, health ------------------------------------------------------------------------------------------


def test_a_result_is_in_variables_in_the_counts_and_an_event(site: Site) -> None:
    async def say(plain: Plain) -> None:
        heard = await _events(plain)
        before = [await plain.read(f"Admin.{name}") for name in ("Processed", "Defective")]
        site.cell.say(RESULT)
        event = await asyncio.wait_for(heard.get(), 30)
        assert CycleResult.model_validate_json(event.Json) == RESULT
        assert (event.Code, event.JobId, event.Severity) == ("GRASP_MISSED", "j1", 500)
        shown = [await plain.read(f"Result.{name}") for name in ("CycleId", "Result", "Code", "JobId", "WallS")]
        assert shown == ["c1", "FAILED", "GRASP_MISSED", "j1", 2.0]
        assert await plain.read("Status.CurMachSpeed") == 30.0
        site.cell.say(RESULT.model_copy(update={"result": "EMPTY", "code": Code.NO_OBJECT}))
        await plain.until("Status.EquipmentStarved", True)
        after = [await plain.read(f"Admin.{name}") for name in ("Processed", "Defective")]
        assert after == [before[0] + 1, before[1] + 1], "an empty table is no defective product"
        (counted,) = await plain.read("Admin.ProdDefectiveCount")
        assert (counted.Name, counted.Count) == ("failed picks", after[1])
        site.cell.enter(State.STARTING)
        await plain.until("Status.EquipmentStarved", False)

    talk(site.endpoint, say)


def test_an_abort_is_an_alarm_and_a_warning_stays_in_the_history(site: Site) -> None:
    async def say(plain: Plain) -> None:
        heard = await _events(plain)
        site.cell.enter(State.ABORTING, "The node 'arm' ended.")
        site.cell.enter(State.ABORTED, "The node 'arm' ended.")
        await plain.until("Status.StateName", "Aborted")
        (active,) = await plain.read("Admin.Alarm")
        assert active.Trigger and "The node 'arm' ended." in active.Message
        assert await plain.read("Admin.StopReasonText") == "The node 'arm' ended."
        assert (await plain.read("Admin.StopReason")).ID > 0
        site.cell.enter(State.CLEARING)
        await plain.until("Status.StateName", "Clearing")
        assert await plain.read("Admin.Alarm") == []
        site.cell.say(Event(code="GAVE_UP", severity="error", text="Three in a row failed."))
        assert (await asyncio.wait_for(heard.get(), 30)).Severity == 800
        assert "Three in a row" in (await plain.read("Admin.AlarmHistory"))[0].Message

    talk(site.endpoint, say)


def test_a_cell_that_is_gone_is_shown_so_until_it_is_back(site: Site) -> None:
    async def say(plain: Plain) -> None:
        site.cell.bus.withdraw(topics.LEASE, name=CELL_CLIENT)
        await plain.until("Connected", False)
        assert await plain.status("Stop") == "BadNoCommunication", "at once, and not when nobody has answered"
        site.cell.bus.announce(topics.LEASE, name=CELL_CLIENT)
        await plain.until("Connected", True)

    talk(site.endpoint, say)


def test_a_state_that_is_none_is_not_shown(site: Site) -> None:
    """Of another version, or of a stranger behind a router."""

    async def say(plain: Plain) -> None:
        strange = site.cell.now().model_copy(update={"state": "Dancing", "since_ns": 10**30})
        site.cell.bus.publish(topics.STATE, strange)
        site.cell.bus.publish(topics.STATE, strange.model_copy(update={"state": "Held"}))
        await plain.until("Status.StateName", "Held")

    talk(site.endpoint, say)


async def _events(plain: Plain) -> asyncio.Queue[Any]:
    """The events of the cell from now on."""
    heard: asyncio.Queue[Any] = asyncio.Queue()

    class Hear:
        def event_notification(self, event: Any) -> None:
            heard.put_nowait(event)

    base = plain.client.get_node(ua.NodeId(ua.ObjectIds.BaseEventType))
    kinds = [await base.get_child(f"{plain.index}:{name}") for name in ("RefusalEvent", "ResultEvent", "CellEvent")]
    subscription = await plain.client.create_subscription(5, Hear())
    await subscription.subscribe_events(plain.node(), kinds)
    return heard


# --- the lease --------------------------------------------------------------------------------------------------------


def test_the_lease_is_the_sessions_until_it_gives_it_back(site: Site) -> None:
    async def say(plain: Plain) -> None:
        await plain.call("Reset")
        holder = site.cell.leases.holder
        assert holder.startswith("opcua-")
        async with connected(site.endpoint) as other:
            assert await other.status("Reset") == "BadLocked"
            assert await plain.read("LastRefusal.Code") == "LEASE_HELD"
            await plain.call("Release")
            assert site.cell.lost.get(timeout=30) == holder
            assert await other.status("Reset") == "Good"
            assert (taken := site.cell.leases.holder) != holder
            await other.call("Release")
            assert site.cell.lost.get(timeout=30) == taken
            await plain.call("Reset")
            again = site.cell.leases.holder
            assert again != holder, "the end of the first connection could be taken for the end of this one"

    talk(site.endpoint, say)


@pytest.mark.parametrize("subscribes", [False, True], ids=["no subscription", "a subscription"])
def test_a_client_that_is_killed_loses_its_lease_at_once(site: Site, subscribes: bool) -> None:
    """The package keeps the session of one with a subscription until its time-out, 600 s as its own clients ask."""

    async def say(plain: Plain) -> None:
        if subscribes:
            await _events(plain)
        await plain.call("Reset")
        plain.break_off()
        assert (await asyncio.to_thread(site.cell.lost.get, timeout=AT_ONCE_S)).startswith("opcua-")

    talk(site.endpoint, say, timeout_s=2)


def test_a_client_that_is_silent_loses_its_lease_with_its_session(site: Site) -> None:
    """As one that is frozen, or behind a cut cable: it asked for a session of 1 s."""

    async def prepare(client: Client) -> None:
        client.session_timeout = 1000

    async def run() -> None:
        async with connected(site.endpoint, prepare) as plain:
            for name in ("_supervisor_task", "_stale_watchdog_task", "_renew_channel_task"):
                getattr(plain.client, name).cancel()
            asked_s = time.monotonic()
            await plain.call("Reset")
            await asyncio.to_thread(site.cell.lost.get, timeout=AT_ONCE_S)
            assert time.monotonic() - asked_s > 0.5
            plain.break_off()

    asyncio.run(run())


def test_a_command_that_arrives_after_its_client_has_gone_moves_nothing(site: Site) -> None:
    """It waited behind another; whether the cell took that one or not, nobody holds the lease in the end."""

    async def say(plain: Plain) -> None:
        site.cell.goes_on.clear()
        calls = [asyncio.create_task(plain.raw("Reset")) for _ in range(3)]
        assert await asyncio.to_thread(site.cell.arrived.acquire, timeout=30)
        plain.break_off()
        async with connected(site.endpoint):
            site.cell.goes_on.set()  # by now the door has noticed it
        await asyncio.gather(*calls, return_exceptions=True)
        give_up_s = time.monotonic() + 30
        while site.cell.lost.empty():
            assert time.monotonic() < give_up_s
            await asyncio.sleep(0.01)
        assert len(site.cell.commands) == 1
        assert site.cell.leases.holder == ""

    talk(site.endpoint, say, timeout_s=2)


def test_a_cell_that_answers_late_keeps_no_other_client_waiting(site: Site) -> None:
    async def say(plain: Plain) -> None:
        async with connected(site.endpoint) as other:
            site.cell.goes_on.clear()
            waiting = asyncio.create_task(plain.raw("Reset"))
            assert await asyncio.to_thread(site.cell.arrived.acquire, timeout=30)
            await other.until("Status.StateName", "Stopped")
            assert await other.status("Abort") == "Good"
            assert not waiting.done()
            site.cell.goes_on.set()
            await waiting

    talk(site.endpoint, say)
    assert [verb for verb, _ in site.cell.commands] == ["abort", "reset"]


def test_of_two_clients_that_come_at_once_only_the_one_that_goes_loses_its_lease(site: Site) -> None:
    async def run() -> None:
        for _ in range(4):
            async with connected(site.endpoint, timeout_s=2) as one, connected(site.endpoint, timeout_s=2) as two:
                statuses = await asyncio.gather(one.status("Reset"), two.status("Reset"))
                assert sorted(statuses) == ["BadLocked", "Good"]
                holder, other = (one, two) if statuses[0] == "Good" else (two, one)
                named = site.cell.leases.holder
                other.break_off()
                async with connected(site.endpoint) as third:
                    assert await third.status("Reset") == "BadLocked"
                assert (site.cell.leases.holder, site.cell.lost.empty()) == (named, True)
                holder.break_off()
                assert await asyncio.to_thread(site.cell.lost.get, timeout=30) == named

    asyncio.run(run())


# --- what waits for a person, and what the camera sees ----------------------------------------------------------------


def test_a_proposal_is_shown_and_answered(site: Site) -> None:
    proposal = Proposal(proposal_id="c1-0", cycle_id="c1", grasp=0, base_from_tcp=np.eye(4), score=0.9,
                        opening_m=0.05, object="the cup", motion_s=3.0, segments_s={}, rejected=0, passed_over=0,
                        until_ns=1)  # fmt: skip

    async def say(plain: Plain) -> None:
        await plain.call("Reset")
        site.cell.propose(proposal)
        await plain.until("Proposal.Id", "c1-0")
        assert json.loads(await plain.read("Proposal.Json"))["object"] == "the cup"
        holder = site.cell.leases.holder
        assert await plain.status("Approve", "c1-0") == "Good"
        assert await plain.status("NextGrasp", "c1-0", "too near the wall") == "Good"
        assert await plain.status("Reject", "c1-0", "x" * 400) == "BadInvalidArgument"
        async with connected(site.endpoint) as other:
            assert await other.status("Reject", "", "not today") == "Good"
        answers = [(verb, said.proposal, said.reason) for verb, said in site.cell.commands[1:]]
        assert answers == [
            ("approve", "c1-0", ""),
            ("next_grasp", "c1-0", "too near the wall"),
            ("reject", "", "not today"),
        ]
        names = [said.client_id for _, said in site.cell.commands]
        assert names[:3] == [holder] * 3, "who holds the lease answers by that name"
        assert names[3].startswith("opcua-") and names[3] not in holder
        site.cell.enter(State.COMPLETING)
        await plain.until("Proposal.Id", "")

    talk(site.endpoint, say)


def test_a_proposal_whose_message_was_lost_is_asked_for(site: Site) -> None:
    proposal = Proposal(proposal_id="c1-1", cycle_id="c1", grasp=0, base_from_tcp=np.eye(4), score=0.9,
                        opening_m=0.05, object="the cup", motion_s=3.0, segments_s={}, rejected=0, passed_over=0,
                        until_ns=1)  # fmt: skip

    async def say(plain: Plain) -> None:
        site.cell.state, site.cell.stage = State.EXECUTE, "approve"
        site.cell.proposal = proposal
        await plain.until("Proposal.Id", "c1-1")
        site.cell.enter(State.COMPLETING)
        await plain.until("Proposal.Id", "")

    talk(site.endpoint, say)


def test_what_the_camera_sees_is_given_to_anybody(site: Site) -> None:
    async def say(plain: Plain) -> None:
        png, taken_at, stamp = await plain.call("Picture")
        assert (png, taken_at.timestamp()) == (PICTURE.data, PICTURE.stamp_ns // 10**9)
        assert int(stamp) == PICTURE.stamp_ns, "a pixel of it names its picture: `picture_ns`"

    talk(site.endpoint, say)


# --- strangers --------------------------------------------------------------------------------------------------------


def test_a_session_cannot_be_taken_over_by_guessing_its_token(site: Site) -> None:
    """The package's own count up from 1001."""

    async def say(plain: Plain) -> None:
        token = plain.client.uaclient.protocol.authentication_token
        assert isinstance(token.Identifier, bytes) and len(token.Identifier) == 32
        async with connected(site.endpoint) as thief:
            assert thief.client.uaclient.protocol.authentication_token != token
        for guess in (ua.NodeId(1001), ua.NodeId(1002), ua.NodeId(bytes(32), 0, ua.NodeIdType.ByteString)):
            client = Client(site.endpoint, timeout=5)
            await client.connect_socket()
            try:
                await client.send_hello()
                await client.open_secure_channel()
                client.uaclient.protocol.authentication_token = guess
                params = ua.ActivateSessionParameters()
                params.UserIdentityToken = ua.AnonymousIdentityToken(PolicyId="anonymous")
                with pytest.raises(ua.uaerrors.BadSessionIdInvalid):
                    await client.uaclient.activate_session(params)
            finally:
                client.disconnect_socket()

    talk(site.endpoint, say)


def test_a_subscription_is_its_sessions_alone(site: Site) -> None:
    """Their numbers count up; the package lets every session end and take over those of all others."""

    async def say(plain: Plain) -> None:
        heard = await _events(plain)
        (number,) = plain.client.uaclient._subscription_callbacks
        async with connected(site.endpoint) as thief:
            line = thief.client.uaclient.session
            (status,) = await line.delete_subscriptions([number])
            assert status.name == "BadSubscriptionIdInvalid"
            off = ua.SetPublishingModeParameters(PublishingEnabled=False, SubscriptionIds=[number])
            (status,) = await line.set_publishing_mode(off)
            assert status.name == "BadSubscriptionIdInvalid"
            with pytest.raises(ua.UaStatusCodeError):
                await line.transfer_subscriptions(ua.TransferSubscriptionsParameters(SubscriptionIds=[number]))
            own = await thief.client.create_subscription(5, object())
            own.subscription_id = number
            with pytest.raises(ua.uaerrors.BadSubscriptionIdInvalid):
                await own.subscribe_events(thief.node())
        site.cell.say(Event(code="STILL", severity="info", text="It is heard."))
        assert (await asyncio.wait_for(heard.get(), 30)).Code == "STILL"

    talk(site.endpoint, say)


def test_it_listens_on_loopback_alone(site: Site) -> None:
    port = urlsplit(site.endpoint).port
    assert urlsplit(load_station().opcua.endpoint).hostname == "127.0.0.1"
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), 5)


def test_nobody_writes_adds_or_registers_anything(site: Site) -> None:
    async def prepare(client: Client) -> None:
        client.set_user("admin")  # with the package's own users, an administrator, whatever the password
        client.set_password("x")

    async def run() -> None:
        with pytest.raises(ua.uaerrors.BadIdentityTokenRejected):
            async with connected(site.endpoint, prepare):
                pass
        async with connected(site.endpoint) as plain:
            for path in ("Status.StateCurrent", "LastRefusal.Code", "TagID"):
                with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                    await plain.node(path).write_value("x")
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                await plain.node().add_variable(plain.index, "mine", 1)
            server = ua.RegisteredServer(ServerUri="urn:mine", ServerNames=[ua.LocalizedText("mine")])
            with pytest.raises(ua.UaStatusCodeError):
                await plain.client.uaclient.register_server(server)

    asyncio.run(run())


def test_what_is_no_opc_ua_ends_nothing_but_its_own_connection(site: Site) -> None:
    rng = random.Random(1)
    where = (urlsplit(site.endpoint).hostname, urlsplit(site.endpoint).port)
    junk = [rng.randbytes(200) for _ in range(20)]
    junk += [b"HELF" + struct.pack("<I", 2**31), b"MSGF" + struct.pack("<I", 8), b"OPNF" + struct.pack("<I", 0)]
    for bytes_ in junk:
        with socket.create_connection(where, 5) as line:
            line.sendall(bytes_)

    async def say(plain: Plain) -> None:
        assert await plain.read("Connected")

    talk(site.endpoint, say)


def test_a_thousand_random_calls_leave_it_whole(site: Site) -> None:
    rng = random.Random(7)
    kinds: list[Callable[[], Any]] = [
        lambda: "", lambda: "left", lambda: '{"name": "left"}', lambda: "x" * rng.randrange(100_000),
        lambda: rng.randrange(2**31), lambda: ua.Variant(rng.randrange(9), ua.VariantType.UInt32),
        lambda: rng.random() < 0.5, lambda: rng.randbytes(8), lambda: [1, 2], lambda: 1.5, lambda: "\0\u20ac",
    ]  # fmt: skip

    async def say(plain: Plain) -> None:
        for number in range(1000):
            if number % 20 == 0:
                site.cell.enter(rng.choice(list(State)))
            given = [rng.choice(kinds)() for _ in range(rng.randrange(5))]
            result = await plain.raw(rng.choice(METHODS).name, *given)
            assert result.StatusCode.is_good() or result.OutputArguments[1].Value
        assert await plain.status("Abort") in ("Good", "BadInvalidState")

    talk(site.endpoint, say)


# --- names and settings -----------------------------------------------------------------------------------------------


def test_names_and_ids_are_those_of_the_specification() -> None:
    data = os.environ.get("VLAD_CELL_DATA")
    if not data:
        pytest.skip("VLAD_CELL_DATA names no folder with the PackML node set")
    root = ET.parse(Path(data) / "opcua" / "Opc.Ua.PackML.NodeSet2.xml").getroot()
    nodes = {node.get("NodeId", ""): node for node in root if node.get("NodeId")}

    def name(number: int) -> str:
        return nodes[f"ns=1;i={number}"].get("BrowseName", "").removeprefix("1:")

    for kind, number in [*packml.OBJECT_TYPES.items(), *packml.DATA_TYPES.items()]:
        assert name(number) == kind
    for state, node in [*packml.STATES.items(), *packml.OUTER_STATES.items()]:
        assert (name(node.node), name(node.number_node)) == (state, "StateNumber")
        value = nodes[f"ns=1;i={node.number_node}"].find(".//{http://opcfoundation.org/UA/2008/02/Types.xsd}UInt32")
        assert value is not None and value.text == str(node.number)
    assert {number: name(number) for _, number in packml.METHODS.values()} == {
        number: method for method, (_, number) in packml.METHODS.items()
    }
    assert {name(number) for number in packml.BINARY_ENCODINGS.values()} == {"Default Binary"}
    known = {node.get("BrowseName", "").removeprefix("1:") for node in nodes.values()}
    assert {one.path.rpartition(".")[2] for one in VARIABLES if one.is_packml} <= known


def test_the_page_is_written_from_the_tables() -> None:
    assert opcua_page.page() == opcua_page.PAGE.read_text(), "run: just docs"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("opcua.endpoint=opc.tcp://0.0.0.0:4840/cell", "beyond loopback"),
        ("opcua.endpoint=opc.tcp://cell.lab:4840/cell", "needs opcua.certificate"),
        ("opcua.endpoint=http://127.0.0.1:4840", "an endpoint is opc.tcp"),
        ("opcua.key=cell.key", "go together"),
        ("opcua.session_timeout_s=0.1", "greater than or equal to 1"),
    ],
)
def test_what_is_not_safe_is_refused(setting: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        load_station(None, [setting])


# --- the documented client --------------------------------------------------------------------------------------------


def test_the_documented_clients_session_goes_on_while_it_looks_for_its_pixel(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def run() -> None:
        loop = asyncio.get_running_loop()

        def pixel_of(png: bytes, color: str) -> tuple[int, int]:
            goes_on = threading.Event()
            loop.call_soon_threadsafe(goes_on.set)
            raise ValueError("the session went on" if goes_on.wait(10) else "the session stood still")

        monkeypatch.setitem(sys.modules, "pixel", SimpleNamespace(pixel_of=pixel_of))
        async with connected(site.endpoint) as other:
            await other.until("Status.StateName", "Idle")
        await pick(site.endpoint, "orange")

    site.cell.enter(State.IDLE)
    with pytest.raises(ValueError, match="the session went on"):
        asyncio.run(run())
