"""Who may make the arm move, or set a fault - and what happens when that client is gone."""

from __future__ import annotations

import queue
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from typer.testing import CliRunner

from bus import topics
from bus.clock import WallClock
from bus.commands import CommandReply, CommandRequest
from bus.errors import Refused
from bus.fault_injection import Fault
from bus.sample import Sample
from bus.session import Bus
from bus.starvation import Starvation
from cell import client
from cell.cli.commands import command_line
from cell.machine.leases import Leases
from config.schema import Station

IDLE = Starvation(1.0, 1.0, 2)


@pytest.fixture
def lost() -> queue.SimpleQueue[str]:
    return queue.SimpleQueue()


@pytest.fixture
def leases(lost: queue.SimpleQueue[str]) -> Leases:
    return Leases(lambda client_id, _why: lost.put(client_id), silence_s=1.0, look_s=0.05, arrival_s=0.01)


@pytest.mark.parametrize("verb", ["reset", "start", "pick", "unhold", "unsuspend"])
def test_what_moves_the_arm_needs_a_token(leases: Leases, verb: str) -> None:
    with pytest.raises(Refused, match="liveliness token") as refusal:
        leases.require(verb, "app", time.monotonic())
    assert refusal.value.code == "NO_LEASE"
    leases.change("app", True)
    leases.require(verb, "app", time.monotonic())


@pytest.mark.parametrize("verb", ["stop", "abort", "hold", "suspend", "clear"])
def test_anyone_may_stop_or_hold(leases: Leases, verb: str) -> None:
    leases.change("app", True)
    leases.take("pick", "app")
    leases.require(verb, "", time.monotonic())
    assert leases.take(verb, "") == "app"


def test_one_holds_the_lease_until_its_token_goes(leases: Leases, lost: queue.SimpleQueue[str]) -> None:
    for name in ("app", "other"):
        leases.change(name, True)
    assert leases.take("reset", "app") == "app"
    with pytest.raises(Refused, match="'app'") as refusal:
        leases.require("pick", "other", time.monotonic())
    assert refusal.value.code == "LEASE_HELD"
    leases.require("unhold", "other", time.monotonic())
    assert leases.take("unhold", "other") == "app" and lost.empty()
    leases.change("other", False)
    assert lost.empty()
    leases.change("app", False)
    assert (lost.get(timeout=60), leases.holder) == ("app", "")


def test_a_token_that_goes_in_the_moment_of_its_command_is_lost(leases: Leases, lost: queue.SimpleQueue[str]) -> None:
    assert leases.take("pick", "app") == ""
    assert lost.get(timeout=60) == "app"


def test_many_that_wait_for_a_token_wait_together(leases: Leases) -> None:
    """400 commands without a token, all received before: a rightful one behind them does not wait 400 times."""
    received_s = time.monotonic() - 1.0
    began_s = time.process_time()
    for number in range(400):
        with pytest.raises(Refused):
            leases.require("reset", f"stranger-{number}", received_s)
    assert time.process_time() - began_s < 1.0


class _Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def _beating(clock: _Clock, lost: list[tuple[str, str]]) -> Leases:
    leases = Leases(lambda *said: lost.append(said), silence_s=0.5, look_s=0.05, clock=WallClock(clock, lambda: IDLE))
    leases.change("app", True)
    assert leases.take("pick", "app") == "app"
    return leases


def _pass(leases: Leases, clock: _Clock, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        clock.now_s += 0.05
        leases.look()


def test_a_holder_whose_heartbeat_falls_silent_loses_the_lease_though_its_token_lives() -> None:
    clock, lost = _Clock(), list[tuple[str, str]]()
    leases = _beating(clock, lost)
    for _ in range(10):
        _pass(leases, clock, 0.2)
        leases.hear(Sample("lease/app", "", b"{}"))
    assert leases.holder == "app" and not lost
    _pass(leases, clock, 0.6)
    assert lost == [("app", "no heartbeat for 0.5 s")] and leases.holder == ""
    leases.hear(Sample("lease/app", "", b"{}"))
    assert leases.holder == "", "what comes back must command anew"


@pytest.mark.parametrize(("key", "source"), [("lease/other", ""), ("lease/app", "another session")])
def test_the_heartbeat_of_another_keeps_no_lease(key: str, source: str) -> None:
    clock, lost = _Clock(), list[tuple[str, str]]()
    leases = _beating(clock, lost)
    for _ in range(12):
        _pass(leases, clock, 0.05)
        leases.hear(Sample(key, "", b"{}", source))
    assert [client_id for client_id, _ in lost] == ["app"]


def test_a_cell_that_stood_still_itself_takes_nobodys_lease() -> None:
    clock, lost = _Clock(), list[tuple[str, str]]()
    leases = _beating(clock, lost)
    clock.now_s += 10.0
    leases.look()
    assert leases.holder == "app"
    _pass(leases, clock, 0.7)
    assert lost, "but silence after that counts"


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


@pytest.fixture(scope="module")
def pace() -> float:
    """Twice real time: slow enough to stop a motion in the midst of it."""
    return 2.0


@pytest.fixture
def picker(shared_cell: Station, shared_options: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A program whose pick is under way."""
    process = subprocess.Popen(
        [sys.executable, "-c", _PICKER, *shared_options[1::2]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    yield process
    process.kill()
    process.communicate()


def test_a_cell_whose_client_dies_in_mid_motion_holds_and_another_may_go_on(
    shared_cell: Station, picker: subprocess.Popen[str]
) -> None:
    assert picker.stdout is not None
    cycle_id = picker.stdout.readline().strip()
    with client.connect(shared_cell) as cell:
        give_up_s = time.monotonic() + 60
        while cell.state().stage != "execute":
            assert time.monotonic() < give_up_s
            time.sleep(0.02)
        with pytest.raises(Refused) as refusal:
            cell.command("reset")
        assert refusal.value.code == "LEASE_HELD"
        picker.kill()
        assert "was lost" in cell.wait_for_state({"Held"}, 60).reason
        reply = cell.command("unhold")
        assert reply.lease == cell.client_id
        result = cell.wait_for_result(cycle_id, 90)
    assert result.result == "SUCCESS", result.reason


def test_a_stranger_without_a_token_moves_nothing(shared_cell: Station) -> None:
    with Bus.join(shared_cell.cell_id, shared_cell.bus.endpoint) as bus:
        request = CommandRequest(client_id="stranger")
        with pytest.raises(Refused) as refusal:
            bus.request(topics.COMMAND, request, CommandReply, timeout_s=60, verb="reset")
        assert refusal.value.code == "NO_LEASE"


def test_where_faults_are_not_allowed_nobody_listens(shared_cell: Station, shared_options: list[str]) -> None:
    with client.connect(shared_cell) as cell:
        for part in ("arm", "disk"):  # one of the node's, one of the daemon's
            with pytest.raises(Refused, match=r"faults\.allowed") as refusal:
                cell.fault(part, Fault.OFF)
            assert refusal.value.exit_code == 3
        outcome = CliRunner().invoke(command_line(), ["fault", "arm", "off", *shared_options])
        assert isinstance(outcome.exception, Refused)
        assert CliRunner().invoke(command_line(), ["fault", "leg", "off"]).exit_code == 2
