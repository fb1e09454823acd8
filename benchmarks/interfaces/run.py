"""All doors of one simulated cell in one run, beside the contacts on an approach line."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks import contact
from benchmarks.interfaces import http, opcua, zenoh
from benchmarks.interfaces.multi_pick import multi_pick
from cell import client
from cell.build import running_cell
from config.load import load_station

_PATIENCE_S = 60.0


def run(rounds: int, contacts: int, pairs: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Return the figures of every door, each asked ``rounds`` times, and of ``contacts`` descents onto something.

    Args:
        pairs: picks of two things at once of each kind, and as many single picks.

    Each door's figures have the ``load`` of the machine after them, of the last minute: they depend on it.
    """
    tell("over the bus")
    figures: dict[str, Any] = {"zenoh": {"accept_ms": _over_the_bus(rounds), "load": _load()}}
    tell("over HTTP")
    figures["http"] = {**http.measure(rounds), "load": _load()}
    tell("over OPC UA")
    with opcua.cell_with_door() as endpoint:
        figures["opcua"] = {**opcua.measure(endpoint, rounds), "load": _load()}
    tell("several things at once")
    figures["multi_pick"] = multi_pick(pairs, pairs, 1000, tell, None)
    tell("contacts")
    return {**figures, **contact.run(contacts, contacts, 1000, tell)}


def _load() -> float:
    return round(os.getloadavg()[0], 1)


def _over_the_bus(rounds: int) -> dict[str, Any]:
    with TemporaryDirectory() as folder:
        station = load_station(None, ["sim.pace=1", f"recording.folder={Path(folder)}"])
        with running_cell(station, lambda topic, message: None), client.connect(station) as cell:
            cell.command("reset")
            cell.wait_for_state({"Idle"}, _PATIENCE_S)
            cell.command("start", cycles=rounds)
            figures = zenoh.accept_ms(cell, rounds)
            cell.command("stop")
            cell.wait_for_state({"Stopped"}, _PATIENCE_S)
        return figures
