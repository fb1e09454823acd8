"""A station without faults runs without the code that injects them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
INJECTION = {
    "bus.faulty_bus",
    "cell.fault_injection",
    "drivers.node.fault_injection",
    "logs.mcap.fault_injection",
    "perception.models.fault_injection",
}
RUN = """
import os
import sys
from cell.build import running_cell
from cell.cli.picks import control, pick
from cell.cli.recorded import show as recordings, replay
from cell.cli.serving import start
from cell.cli.station import setup
from config.load import load_station
from drivers.interface import Devices
from drivers.node.link import join_cell
from drivers.node.node import Node

station = load_station(None, ["nodes.sim.run=elsewhere", *sys.argv[1:]])
with running_cell(station, lambda topic, message: None), join_cell(station) as bus:
    node = Node("sim", bus, Devices(), station)
    node.open()
    node.close()
print(*sorted(name for name in sys.modules if "fault_injection" in name or name == "bus.faulty_bus"), flush=True)
os._exit(0)  # as a node does: native threads may still run
"""
"""A cell and a node of it in one process: without devices, which would only take time to start."""


def _imported(endpoint: str, folder: Path, *overrides: str) -> set[str]:
    """The modules about injection that a process has imported which ran a cell and a node."""
    options = [f"bus.endpoint={endpoint}", f"recording.folder={folder}", *overrides]
    run = [sys.executable, "-c", RUN, *options]
    ran = subprocess.run(run, cwd=REPOSITORY, capture_output=True, text=True, timeout=240, check=False)
    assert ran.returncode == 0, ran.stderr
    return set(ran.stdout.split())


def test_a_cell_and_its_node_import_no_fault_unless_faults_are_allowed(endpoint: str, tmp_path: Path) -> None:
    assert _imported(endpoint, tmp_path) == {"bus.fault_injection", "config.fault_injection"}, (
        "the words for them alone"
    )


@pytest.mark.thorough
def test_where_faults_are_allowed_they_are_there(endpoint: str, tmp_path: Path) -> None:
    assert _imported(endpoint, tmp_path, "faults.allowed=true") >= INJECTION
