"""Serves one node in a process of its own: as a child of the daemon, or in a terminal (``cell node``)."""

from __future__ import annotations

import io
import json
import logging
import os
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import IO

from bus import topics
from bus.codec import encode
from bus.errors import CellError
from bus.remote_errors import error_reply
from bus.seal import Seal
from bus.threads import handled_by
from cell.machine.leases import CELL_CLIENT
from cell.nodes.pipes import own_stdout
from cell.nodes.process import freeze_gc, limit_malloc_arenas
from cell.nodes.ready import Ready
from cell.terminal.signals import on_end
from config.load import station_from
from config.schema import Station
from drivers.node.link import join_cell
from drivers.node.node import Node
from drivers.node.registry import open_node

_log = logging.getLogger(__name__)
_DEFECT_EXIT_CODE = 70
"""EX_SOFTWARE of sysexits.h."""


def serve_supervised(name: str) -> int:
    """Serve node ``name`` of the station on stdin until stdin closes. Returns the exit code."""
    return _serve(name, io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8"), own_stdout())


def _serve(name: str, stdin: IO[str], stdout: IO[str]) -> int:
    limit_malloc_arenas()
    station, secret = station_from(json.loads(stdin.readline())), bytes.fromhex(stdin.readline())
    try:
        with join_cell(station) as bus:
            bus.seal = Seal(secret) if secret else None
            node = Node(name, bus, open_node(name, station), station)
            with handled_by(partial(_end_by_defect, node)):
                node.open()
                _say(stdout, Ready(node=name, pid=os.getpid()))
                with freeze_gc():
                    stdin.read()
                node.close()
    except CellError as error:
        _say(stdout, Ready(node=name, pid=os.getpid(), error=error_reply(error)))
        return error.exit_code
    return 0


def _end_by_defect(node: Node, name: str, defect: BaseException) -> None:
    """End this process after a defect. The arm stops first, and the cell receives the reason."""
    try:
        node.end_by_defect(name, defect)
    finally:
        logging.shutdown()
        os._exit(_DEFECT_EXIT_CODE)


def serve_until_interrupted(name: str, station: Station, tell: Callable[[str], None]) -> None:
    """Serve a node in a terminal of its own (``run = "elsewhere"``) until Ctrl-C, SIGTERM or SIGHUP.

    When the cell or the link to it is lost, the arm stops, because no stop of the cell could reach it.

    Args:
        tell: takes one line, as soon as the devices are served.
    """
    limit_malloc_arenas()
    ended = threading.Event()
    on_end(ended.set)
    with ExitStack() as stack:
        bus = stack.enter_context(join_cell(station, station.bus.zenoh))
        node = Node(name, bus, open_node(name, station), station)
        stack.enter_context(handled_by(partial(_end_by_defect, node)))
        node.open()

        def change(client_id: str, is_alive: bool) -> None:
            if client_id == CELL_CLIENT and not is_alive:
                _log.warning("the cell, or the link to it, is gone")
                bus.worker("arm-stop").submit(node.halt)

        bus.watch_alive(topics.LEASE, change)
        served = ", ".join(station.nodes[name].serves)
        tell(f"node {name} of cell {station.cell_id} serves {served}; Ctrl-C ends")
        try:
            with freeze_gc():
                ended.wait()
        finally:
            node.close()


def _say(stdout: IO[str], ready: Ready) -> None:
    stdout.write(encode(ready).decode() + "\n")
    stdout.flush()
