"""`cell status` says all that is wrong: nodes, doors, and defects of the daemon; every list of problems is that one."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from bus.commands import CellHealth, CellState, DoorHealth, NodeHealth
from cell.cli.network.fleet import Member

Run = Callable[..., subprocess.CompletedProcess[str]]
IDLE = CellState(state="Idle", stage="", cycle_id="", since_ns=1, available=("pick",), reason="")
CLOSED = DoorHealth(problem="cannot open: Another program listens on 127.0.0.1:8088.", advice="Set http.port.")
HEALTH = CellHealth(
    is_healthy=False,
    nodes={"sim": NodeHealth(is_alive=True, problems=(), restarts=0, said=None)},
    doors={"http": CLOSED, "opcua": DoorHealth(endpoint="opc.tcp://127.0.0.1:4840/cell")},
    defects=("KeyError in retention",),
)


class Connected:
    """Stands for a connection to a cell with these troubles."""

    def __enter__(self) -> Any:
        return SimpleNamespace(state=lambda: IDLE, health=lambda: HEALTH)

    def __exit__(self, *_: object) -> None: ...


def test_a_door_that_is_closed_stays_visible_with_what_to_do(in_process: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.client.connect", lambda _station: Connected())
    assert in_process("status").stdout.splitlines()[2:] == [
        "  node sim: healthy",
        "  door http: cannot open: Another program listens on 127.0.0.1:8088. Set http.port.",
        "  door opcua: opc.tcp://127.0.0.1:4840/cell",
        "  defect: KeyError in retention",
    ]


def test_a_fleet_shows_the_same_problems() -> None:
    problems = [f"http: {CLOSED.problem}", "KeyError in retention"]
    assert HEALTH.problems == Member("cell1", IDLE, HEALTH).problems == problems
