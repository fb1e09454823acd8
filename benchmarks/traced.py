"""A node of a simulated cell whose arm's states also come over a pipe, which a frozen daemon cannot delay.

It is a `drivers.node.node.Node` like any other; its cell has ``nodes.NAME.run = "elsewhere"``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from benchmarks.stopping import Moment
from bus.session import Bus
from cell.nodes.process import freeze_gc, limit_malloc_arenas
from config.load import load_station
from drivers.node.node import Node
from drivers.node.registry import open_node

_PERIOD_S = 0.01
_READY = "ready\n"


@contextmanager
def node_traced(name: str, overrides: list[str], hear: Callable[[Moment], None]) -> Iterator[None]:
    """The node of a running cell, in a process of its own. ``hear`` is told its arm's states on another thread."""
    command = [sys.executable, "-m", "benchmarks.traced", name, *overrides]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    lines = process.stdout

    def listen() -> None:
        for line in lines:
            stamp_ns, q_rad, dq_rad_s = json.loads(line)
            hear(Moment(stamp_ns, np.array(q_rad), np.array(dq_rad_s)))

    ear = threading.Thread(target=listen)
    try:
        assert lines.readline() == _READY, "the node does not start: see its own message above"
        ear.start()
        yield
    finally:
        process.stdin.close()
        process.wait(30)
        if ear.ident is not None:
            ear.join()
        lines.close()


def _serve(name: str, overrides: list[str]) -> None:
    """Until stdin closes."""
    limit_malloc_arenas()
    station = load_station(None, overrides)
    ended = threading.Event()
    with Bus.join(station.cell_id, station.bus.endpoint) as bus:
        devices = open_node(name, station)
        node = Node(name, bus, devices, station)
        node.open()
        assert devices.arm is not None
        sys.stdout.write(_READY)
        threading.Thread(target=_await_end, args=(ended,)).start()
        with freeze_gc():
            while not ended.wait(_PERIOD_S):
                state = devices.arm.state()
                said = [state.stamp_ns, state.q_rad.tolist(), state.dq_rad_s.tolist()]
                sys.stdout.write(json.dumps(said) + "\n")
                sys.stdout.flush()
        node.close()


def _await_end(ended: threading.Event) -> None:
    sys.stdin.read()
    ended.set()


if __name__ == "__main__":
    _serve(sys.argv[1], sys.argv[2:])
