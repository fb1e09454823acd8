"""A door is started beside the cell, told of, started again when it dies, and ended with the cell."""

from __future__ import annotations

import queue
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from bus.commands import DoorHealth
from bus.errors import ConfigError
from bus.remote_errors import error_reply
from cell.cli.serving.doors import wanted_doors
from cell.nodes import doors
from cell.nodes.doors import Door
from cell.nodes.ready import Open
from config.load import load_station
from config.schema import Station

STATION = load_station()
OPENS = 'print(\'{"endpoint": "opc.tcp://here", "pid": 1}\', flush=True);'
STAYS = "import sys; sys.stdin.read()"


class Told:
    """The events of a door, and its processes."""

    def __init__(self) -> None:
        self.events: queue.SimpleQueue[tuple[str, ...]] = queue.SimpleQueue()
        self.healths: list[DoorHealth] = []
        self.children: list[subprocess.Popen[str]] = []

    def hear(self, *said: str) -> None:
        self.events.put(said)

    def door(self, *programs: str) -> Door:
        """A door whose processes run these Python programs, one after the other, the last one again and again."""
        left = list(programs)

        def spawn(_name: str, _station: Station) -> subprocess.Popen[str]:
            code = left.pop(0) if len(left) > 1 else left[0]
            child = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            self.children.append(child)
            return child

        return Door("opcua", STATION, self.hear, spawn, lambda _name, now: self.healths.append(now)).start()

    def next(self) -> tuple[str, ...]:
        return self.events.get(timeout=60)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Iterator[Told]:
    monkeypatch.setattr(doors, "_FIRST_PAUSE_S", 0.01)
    told = Told()
    yield told
    assert all(child.poll() is not None for child in told.children), "no door outlives its cell"


def test_an_open_door_is_told_of_and_ends_with_its_cell(told: Told) -> None:
    with closing(told.door(OPENS + STAYS)):
        code, severity, text, _ = told.next()
        assert (code, severity) == ("DOOR_OPEN", "info")
        assert "opc.tcp://here" in text


def test_a_door_that_dies_is_told_of_and_started_again(told: Told) -> None:
    with closing(told.door(OPENS + "import os; os._exit(9)", OPENS + STAYS)):
        assert told.next()[0] == "DOOR_OPEN"
        code, severity, text, _ = told.next()
        assert (code, severity) == ("DOOR_LOST", "warning")
        assert "exit code 9" in text
        assert told.next()[0] == "DOOR_OPEN"


def test_a_door_that_is_frozen_is_ended_and_started_again(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doors, "_LOOK_S", 0.01)
    monkeypatch.setattr(doors, "_FROZEN_S", 0.03)
    with closing(told.door(OPENS + STAYS)):
        assert told.next()[0] == "DOOR_OPEN"
        told.children[0].send_signal(signal.SIGSTOP)
        assert told.next()[0] == "DOOR_LOST"
        assert told.next()[0] == "DOOR_OPEN"
        assert told.children[0].returncode == -signal.SIGKILL


def test_a_door_that_says_nothing_is_tried_again(told: Told) -> None:
    with closing(told.door("raise SystemExit(5)", OPENS + STAYS)):
        code, severity, text, _ = told.next()
        assert (code, severity) == ("DOOR_CLOSED", "error")
        assert "exit code 5" in text
        assert told.next()[0] == "DOOR_OPEN"


def test_what_keeps_a_door_closed_is_said_once_and_stays_in_the_health(told: Told) -> None:
    same, other = "raise SystemExit(5)", "raise SystemExit(6)"
    with closing(told.door(same, same, same, other, other, OPENS + STAYS)):
        said = [told.next() for _ in range(3)]
    assert [(code, text[-40:]) for code, _, text, _ in said] == [
        ("DOOR_CLOSED", "exit code 5). It is tried again until it opens."[-40:]),
        ("DOOR_CLOSED", "exit code 6). It is tried again until it opens."[-40:]),
        ("DOOR_OPEN", said[2][2][-40:]),
    ]
    assert [bool(now.problem) for now in told.healths] == [False, True, True, False]
    assert told.healths[-1] == DoorHealth(endpoint="opc.tcp://here")


def test_a_door_that_is_configured_wrongly_stays_closed(told: Told) -> None:
    error = error_reply(ConfigError("The package is missing.", "Install it."))
    said = Open(pid=1, error=error).model_dump_json()
    with closing(told.door(f"print({said!r}, flush=True)")) as door:
        code, _, text, advice = told.next()
        assert (code, advice) == ("DOOR_CLOSED", "Install it.")
        assert "The package is missing." in text
        door._thread.join(60)
        assert len(told.children) == 1


@pytest.mark.parametrize("close", [lambda door: door.close(), lambda door: (door.close(), door.close())])
def test_a_door_is_closed_while_it_still_opens(told: Told, close: Callable[[Door], Any]) -> None:
    close(told.door(STAYS))
    assert told.events.empty()


def test_a_door_opens_where_an_option_or_the_station_asks_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert wanted_doors(STATION) == []
    assert wanted_doors(STATION, "opcua") == ["opcua"]
    assert wanted_doors(load_station(None, ["opcua.enabled=true"])) == ["opcua"]
    monkeypatch.setattr("cell.opcua.needs.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"vlad-cell\[opcua\]"):  # before the cell starts
        wanted_doors(STATION, "opcua")
