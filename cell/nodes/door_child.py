"""Serves one door: as a child of the cell, or in a terminal of its own (``cell opcua``, ``cell http``)."""

from __future__ import annotations

import io
import json
import os
import sys
import threading
from collections.abc import Callable
from typing import Protocol

from bus.codec import encode
from bus.errors import CellError
from bus.remote_errors import error_reply
from cell.nodes.pipes import own_stdout
from cell.nodes.process import limit_malloc_arenas
from cell.nodes.ready import Open
from cell.terminal.signals import on_end
from config.load import station_from
from config.schema import Station


class Serve(Protocol):
    """Opens a door, serves it, and closes it."""

    def __call__(self, station: Station, tell: Callable[[str], None], wait_for_end: Callable[[], None]) -> None:
        """Serve until the end.

        Args:
            tell: called once with the endpoint, when other programs can reach it.
            wait_for_end: returns when the door is to close; to be called on a thread that may wait.

        Raises: CellError when it cannot open.
        """


def serve_supervised(serve: Serve) -> int:
    """Serve the station on stdin until stdin closes. Returns the exit code; an error goes to the cell, as one line."""
    limit_malloc_arenas()
    stdin, stdout = io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8"), own_stdout()

    def say(opened: Open) -> None:
        stdout.write(encode(opened).decode() + "\n")
        stdout.flush()

    station = station_from(json.loads(stdin.readline()))
    try:
        serve(station, lambda where: say(Open(endpoint=where, pid=os.getpid())), lambda: _read_to_its_end(stdin))
    except CellError as error:
        say(Open(pid=os.getpid(), error=error_reply(error)))
        return error.exit_code
    return 0


def serve_until_interrupted(serve: Serve, station: Station, tell: Callable[[str], None]) -> None:
    """Serve in a terminal until Ctrl-C, SIGTERM or SIGHUP. Raises: as `Serve`."""
    limit_malloc_arenas()
    ended = threading.Event()
    on_end(ended.set)
    serve(station, tell, lambda: _wait(ended))


def _read_to_its_end(stdin: io.TextIOWrapper) -> None:
    stdin.read()


def _wait(ended: threading.Event) -> None:
    ended.wait()
