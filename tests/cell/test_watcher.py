"""``cell watch`` without its terminal: what it takes in, when it gives the lease back, whose name it has."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest

from bus.codec import encode
from bus.commands import CellState, CommandReply, CommandRequest, Health
from bus.errors import NoReply, Refused
from bus.fault_injection import Fault, FaultRequest
from bus.frozen import Message
from bus.sample import Sample
from bus.topics import encoding_of
from cell.cli.picks.watch import Watcher
from cell.client import Client, client_name
from cell.commander import Commander
from config.load import load_station


def _state(name: str, since_ns: int = 0, reason: str = "") -> CellState:
    return CellState(state=name, stage="", cycle_id="", since_ns=since_ns, available=(), reason=reason)


def _heard(key: str, message: Message) -> Sample:
    return Sample(key, encoding_of(type(message)), encode(message))


class ScriptedCell:
    """A connection to a cell that says and answers what a test tells it to."""

    def __init__(self) -> None:
        self.now: CellState | Exception = _state("Stopped")
        self.said: list[Sample] = []
        self.is_gone = False
        self.commands: list[str] = []

    def state(self) -> CellState:
        if isinstance(self.now, Exception):
            raise self.now
        return self.now

    def command(self, verb: str) -> CommandReply:
        return self.send(verb, CommandRequest())

    def send(self, verb: str, _request: CommandRequest) -> CommandReply:
        if verb == "pick":
            raise Refused("The cell moves for 'x'.", code="LEASE_HELD")
        self.commands.append(verb)
        self.now = _state("Resetting", 10)
        return CommandReply(ok=True, state="Resetting", since_ns=10)

    def heard(self) -> Iterator[Sample]:
        yield from self.said
        self.said = []


class AtOnce:
    """Does what is submitted before it returns."""

    def submit(self, work: Any, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(work(*arguments))
        except Exception as error:  # noqa: BLE001 - a future carries whatever it was
            future.set_exception(error)
        return future


class Desk:
    """A watcher of a scripted cell, and how many connections its commands have open."""

    def __init__(self, recordings: Path) -> None:
        self.cell, self.open = ScriptedCell(), 0
        station = load_station(None, [f"recording.folder={recordings}"])
        self.watcher = Watcher(
            cast(Client, self.cell), Commander(self._connect), station, cast(Any, AtOnce()), takes_keys=True
        )

    @contextmanager
    def _connect(self) -> Iterator[Client]:
        self.open += 1
        try:
            yield cast(Client, self.cell)
        finally:
            self.open -= 1

    def say(self, *said: Sample) -> None:
        self.cell.said += said
        self.watcher.turn()


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


@pytest.mark.parametrize(
    "heard",
    [
        Sample("node/sim/health", encoding_of(Health), b"\xff\x00"),
        Sample("node/sim/health", encoding_of(Health), b'{"name": 5}'),
        Sample("node/sim/health", "application/json;vlad.Unknown", b"{}"),
        Sample("node/sim/health", "zenoh/bytes", b""),
        _heard("node/sim/health", FaultRequest(fault=Fault.WRONG)),
        _heard("node/sim/health", _state("Idle", 99)),
        _heard("state", CommandRequest()),
        Sample("nonsense", encoding_of(CellState), encode(_state("Idle", 99))),
    ],
    ids=str,
)
def test_what_cannot_be_read_is_counted_and_named(desk: Desk, heard: Sample) -> None:
    desk.say(heard, heard, _heard("state", _state("Idle", 1)))
    model = desk.watcher.model
    assert model.unread == 2 and model.last_unread.startswith(heard.key)
    assert model.state is not None and model.state.since_ns == 1


def test_the_lease_is_kept_until_what_was_commanded_is_over_and_no_longer(desk: Desk) -> None:
    desk.watcher.press("r")
    desk.say()
    assert desk.open == 1 and desk.cell.commands == ["reset"]
    desk.say(_heard("state", _state("Stopped", 5)))  # of before
    assert desk.open == 1
    desk.say(_heard("state", _state("Resetting", 10)))
    assert desk.open == 1
    desk.say(_heard("state", _state("Idle", 20)))
    assert desk.open == 0
    desk.watcher.press("r")
    assert desk.open == 1


def test_a_refused_command_keeps_no_lease_where_nothing_moves(desk: Desk) -> None:
    desk.watcher.press("p")
    desk.say()
    assert desk.watcher.model.note.startswith("pick: LEASE_HELD") and desk.open == 0


def test_a_cell_that_has_ended_is_said_to_have_ended_and_its_lease_is_gone(desk: Desk) -> None:
    desk.watcher.press("r")
    desk.cell.is_gone, desk.cell.now = True, NoReply("Nobody answers 'state'.", "It is busy or frozen.")
    desk.watcher._asked_s = -100.0  # a second has passed
    desk.say()
    desk.say()
    assert "has ended" in desk.watcher.model.lost and "busy" not in desk.watcher.model.lost and desk.open == 0


def test_a_stopped_cell_still_says_who_stopped_it(desk: Desk) -> None:
    desk.say(_heard("state", _state("Stopping", 1, "command 'stop' from watch-ann-lab2-4711")))
    desk.say(_heard("state", _state("Stopped", 2)))
    assert desk.watcher.model.state is not None
    assert desk.watcher.model.state.reason == "command 'stop' from watch-ann-lab2-4711"


@pytest.mark.parametrize("what", ["watch", "pick", "a b/c*$", "x" * 200])
def test_a_client_is_named_after_who_asks(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    monkeypatch.setenv("LOGNAME", "Änn/☃ " + "y" * 100)
    first, second = client_name(what), client_name(what)
    assert first != second and str(os.getpid()) in first
    assert first.startswith(re.sub(r"[^A-Za-z0-9._-]", "_", what)[:24] + "-_nn")
    for name in (first, second):
        assert CommandRequest(client_id=name).client_id == name  # as a command takes it
