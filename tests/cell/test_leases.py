"""Who may make the arm move - and what happens when that client is gone."""

from __future__ import annotations

import queue
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from bus import topics
from bus.commands import CommandReply, CommandRequest
from bus.errors import Refused
from bus.session import Bus
from cell import client
from cell.leases import Leases
from config.schema import Station

Daemon = tuple[subprocess.Popen[str], Station]


@pytest.fixture
def lost() -> queue.SimpleQueue[str]:
    return queue.SimpleQueue()


@pytest.fixture
def leases(lost: queue.SimpleQueue[str], monkeypatch: pytest.MonkeyPatch) -> Leases:
    monkeypatch.setattr("cell.leases._ARRIVAL_S", 0.01)
    return Leases(lost.put)


@pytest.mark.parametrize("verb", ["reset", "start", "pick", "unhold", "unsuspend"])
def test_what_moves_the_arm_needs_a_token(leases: Leases, verb: str) -> None:
    with pytest.raises(Refused, match="liveliness token") as refusal:
        leases.require(verb, "app")
    assert refusal.value.code == "NO_LEASE"
    leases.change("app", True)
    leases.require(verb, "app")


@pytest.mark.parametrize("verb", ["stop", "abort", "hold", "suspend", "clear"])
def test_anyone_may_stop_or_hold(leases: Leases, verb: str) -> None:
    leases.change("app", True)
    leases.take("pick", "app")
    leases.require(verb, "")
    assert leases.take(verb, "") == "app"


def test_one_holds_the_lease_until_its_token_goes(leases: Leases, lost: queue.SimpleQueue[str]) -> None:
    for name in ("app", "other"):
        leases.change(name, True)
    assert leases.take("reset", "app") == "app"
    with pytest.raises(Refused, match="'app'") as refusal:
        leases.require("pick", "other")
    assert refusal.value.code == "LEASE_HELD"
    leases.require("unhold", "other")
    assert leases.take("unhold", "other") == "app" and lost.empty()
    leases.change("other", False)
    assert lost.empty()
    leases.change("app", False)
    assert (lost.get(timeout=1), leases.holder) == ("app", "")


def test_a_token_that_goes_in_the_moment_of_its_command_is_lost(leases: Leases, lost: queue.SimpleQueue[str]) -> None:
    assert leases.take("pick", "app") == ""
    assert lost.get(timeout=1) == "app"


# --- real processes ---------------------------------------------------------------------------------------------------

_PICKER = """
import sys
from cell import client
from config.load import load_station
with client.connect(load_station(None, sys.argv[1:])) as cell:
    cell.command("reset")
    cell.wait_for_state({"Idle"}, 60)
    print(cell.command("pick").cycle_id, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def picker(shared_daemon: Daemon, shared_options: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A program whose pick is under way."""
    process = subprocess.Popen(
        [sys.executable, "-c", _PICKER, *shared_options[1::2]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    yield process
    process.kill()
    process.communicate()


def test_a_cell_whose_client_dies_in_mid_motion_holds_and_another_may_go_on(
    shared_daemon: Daemon, picker: subprocess.Popen[str]
) -> None:
    assert picker.stdout is not None
    cycle_id = picker.stdout.readline().strip()
    with client.connect(shared_daemon[1]) as cell:
        give_up_s = time.monotonic() + 60
        while cell.state().stage != "execute":
            assert time.monotonic() < give_up_s
            time.sleep(0.02)
        with pytest.raises(Refused) as refusal:
            cell.command("reset")
        assert refusal.value.code == "LEASE_HELD"
        picker.kill()
        assert "was lost" in cell.wait_for_state({"Held"}, 20).reason
        reply = cell.command("unhold")
        assert reply.lease == cell.client_id
        result = cell.wait_for_result(cycle_id, 90)
    assert result.result == "SUCCESS", result.reason


def test_a_stranger_without_a_token_moves_nothing(shared_daemon: Daemon) -> None:
    station = shared_daemon[1]
    with Bus.join(station.cell_id, station.bus.endpoint) as bus:
        request = CommandRequest(client_id="stranger")
        with pytest.raises(Refused) as refusal:
            bus.request(topics.COMMAND, request, CommandReply, timeout_s=5, verb="reset")
        assert refusal.value.code == "NO_LEASE"
