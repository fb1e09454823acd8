"""Starts a simulated cell in a process of its own, on a free port, and ends it surely."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from bus.errors import ConfigError, PortOccupied
from bus.free_port import free_endpoint
from cell.nodes.doors import await_open
from cell.nodes.pipes import close_pipes, end_child
from cell.nodes.starting import spawn_child
from config.clock import clock_of
from config.schema import Station

_log = logging.getLogger(__name__)
_END_S = 20.0
"""Longest time until the cell has ended by itself: its arm rests, its recording is closed."""
_TRIES = 3
"""Another program may take the port between the moment it was found free and that of its use."""


@contextmanager
def running(station: Station) -> Iterator[Station]:
    """Context with a running cell of the station, with the endpoint at which it is reached.

    Raises: ConfigError for a station with real devices; PortOccupied; what keeps the cell from starting.
    """
    if not station.is_simulation:
        raise ConfigError(
            f"The station {station.cell_id!r} has real devices.",
            "Start it with `cell start`, then use Cell(config=...); only a simulated cell ends with your program.",
        )
    for left in reversed(range(_TRIES)):
        there = _at_free_port(station)
        clock = clock_of(there)
        child = spawn_child(there, "vlad_cell.simulated_child")
        try:
            await_open(child, clock)
        except PortOccupied:
            if not left:
                raise
            continue
        except BaseException:  # Ctrl-C among them
            end_child(child, _END_S, clock)
            close_pipes(child)
            raise
        try:
            yield there
        finally:
            if not end_child(child, _END_S, clock):
                _log.warning("the simulated cell did not end by itself; it was killed")
            close_pipes(child)
        return


def _at_free_port(station: Station) -> Station:
    """The station with a loopback endpoint that nobody listens on."""
    alone = {"endpoint": free_endpoint(), "listen": None, "router": None}
    return station.model_copy(update={"bus": station.bus.model_copy(update=alone)})
