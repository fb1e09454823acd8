"""The OPC UA door of a real simulated cell: a pick by the documented client, and one whose client dies in motion."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("asyncua")  # the extra `opcua`

from cell import client
from config.load import load_station
from config.schema import Station
from docs.examples.opcua_client import pick
from tests.cell.opcua_bench import connected, serving

pytestmark = pytest.mark.xdist_group("opcua")
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "opcua_client.py"


@pytest.fixture(scope="module")
def pace() -> float:
    """As fast as it can, but for the motion that a client leaves: that is over before it is held."""
    return 0.0


@pytest.fixture(scope="module")
def endpoint(_shared_here: Station, shared_options: list[str], new_endpoint: Callable[[], str]) -> Iterator[str]:
    door = new_endpoint().replace("tcp/", "opc.tcp://")
    with serving(load_station(None, [*shared_options[1::2], f"opcua.endpoint={door}/cell"])) as where:
        yield where


def test_the_documented_client_picks(shared_cell: Station, endpoint: str) -> None:
    result = asyncio.run(pick(endpoint))
    assert (result["result"], result["code"]) == ("SUCCESS", None)


def test_when_a_client_goes_in_motion_the_cell_holds(shared_cell: Station, endpoint: str) -> None:
    async def run() -> None:
        async with connected(endpoint, timeout_s=2) as plain:
            await plain.call("Reset")
            await plain.until("Status.StateName", "Idle")
            await plain.call("Pick", "", "", "left behind")
            await plain.until("Status.StateName", "Execute")
            async with connected(endpoint) as other:
                plain.break_off()
                await other.until("Status.StateName", "Held")
                assert "nobody attends" in await other.read("Status.Reason")
                assert await other.status("Unhold") == "Good", "another session goes on with it"
                await other.until("Status.StateName", "Complete")
                assert await other.read("Result.JobId") == "left behind"

    asyncio.run(run())


@pytest.mark.thorough
def test_a_cell_starts_its_door_and_a_killed_process_holds_the_cell(
    shared_options: list[str], new_endpoint: Callable[[], str]
) -> None:
    """Whole processes: `cell start --opcua`, and the documented client, killed."""
    bus, door = new_endpoint(), new_endpoint().replace("tcp/", "opc.tcp://") + "/cell"
    options = [*shared_options, "--set", f"bus.endpoint={bus}", "--set", f"opcua.endpoint={door}"]
    station = load_station(None, options[1::2])
    start = [sys.executable, "-m", "cell", "start", "--no-report", "--opcua", "--set", "sim.pace=1", *options]
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert any("DOOR_OPEN" in line for line in process.stdout)
        picking = subprocess.Popen([sys.executable, str(EXAMPLE), door])
        try:
            with client.connect(station) as watching:
                watching.wait_for_state({"Execute"}, 60)
                os.kill(picking.pid, signal.SIGKILL)
                began_s = time.monotonic()
                watching.wait_for_state({"Held"}, 60)
                assert time.monotonic() - began_s < 2.0
        finally:
            picking.kill()
            picking.wait()
            process.terminate()
            process.stdout.read()
    assert process.returncode in (0, 1)
