"""The OPC UA interface: from a method call to its answer, and to the new state in a subscription.

Measured with a plain asyncua client in a process of its own, on a simulated cell whose door is a process of its own, as
`cell start --opcua` has it. The calls are Abort and Clear in turn: nothing moves, and each leads through a new state.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from asyncua import Client, ua

from benchmarks.interfaces.spread import spread_ms
from bus.free_port import free_port

_PUBLISHING_MS = 10
_TURNS = (("Abort", "Aborting", "Aborted"), ("Clear", "Clearing", "Stopped"))
"""Method, the state that it leads to, and the state in which the next one is possible."""
_WARM_UP = 10


class _States:
    """The states as they come, each with the time of its arrival [s, monotonic]."""

    def __init__(self) -> None:
        self.seen: asyncio.Queue[tuple[str, float]] = asyncio.Queue()

    def datachange_notification(self, _node: Any, value: str, _data: Any) -> None:
        self.seen.put_nowait((value, time.monotonic()))

    async def at(self, state: str) -> float:
        """The time at which this state came; those before it are dropped."""
        while True:
            value, seen_s = await asyncio.wait_for(self.seen.get(), 30)
            if value == state:
                return seen_s


def measure(endpoint: str, rounds: int = 250) -> dict[str, Any]:
    """The spreads ``accept_ms`` and ``state_seen_ms`` of ``2 * rounds`` calls on a running cell that is Stopped."""
    accepted_s, seen_s = asyncio.run(_measure(endpoint, rounds))
    return {"accept_ms": spread_ms(accepted_s), "state_seen_ms": spread_ms(seen_s)}


async def _measure(endpoint: str, rounds: int) -> tuple[list[float], list[float]]:
    accepting_s, seeing_s = list[float](), list[float]()
    async with Client(endpoint) as client:
        index = await client.get_namespace_index("urn:vlad-cell:opcua")
        cell = client.get_node(ua.NodeId("Cell", index))
        states = _States()
        subscription = await client.create_subscription(_PUBLISHING_MS, states)
        await subscription.subscribe_data_change(
            client.get_node(ua.NodeId("Cell.Status.StateName", index)), queuesize=100
        )
        await states.at("Stopped")
        for number in range(rounds + _WARM_UP):
            for method, leads_to, then in _TURNS:
                began_s = time.monotonic()
                await cell.call_method(ua.NodeId(f"Cell.{method}", index))
                accepted_s = time.monotonic()
                seen_s = await states.at(leads_to)
                if number >= _WARM_UP:
                    accepting_s.append(accepted_s - began_s)
                    seeing_s.append(seen_s - began_s)
                await states.at(then)
    return accepting_s, seeing_s


@contextmanager
def cell_with_door() -> Iterator[str]:
    """A simulated cell, started as a person does; the endpoint of its door."""
    bus, door = free_port(), free_port()
    endpoint = f"opc.tcp://127.0.0.1:{door}/cell"
    with TemporaryDirectory() as folder:
        settings = (
            f"bus.endpoint=tcp/127.0.0.1:{bus}",
            f"opcua.endpoint={endpoint}",
            f"recording.folder={Path(folder) / 'recordings'}",
        )
        options = [word for setting in settings for word in ("--set", setting)]
        start = [sys.executable, "-m", "cell", "start", "--no-report", "--opcua", *options]
        with subprocess.Popen(start, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                if not any("DOOR_OPEN" in line for line in process.stdout):
                    raise RuntimeError("the cell ended before its door was open")
                yield endpoint
            finally:
                process.terminate()
                if process.stdout is not None:
                    process.stdout.read()
