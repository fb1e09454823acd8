"""A node's session on the bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bus.lazy import LazyModule
from bus.session import Bus
from config.clock import clock_of
from config.schema import Station

if TYPE_CHECKING:
    from bus import faulty_bus
else:
    faulty_bus = LazyModule("bus.faulty_bus")  # only where faults are allowed


def join_cell(station: Station, security: Path | None = None) -> Bus:
    """Join the bus of the station's cell; with fault injection where the station allows it.

    Args:
        security: the Zenoh file of a node on another machine.

    Raises: ConfigError, CellUnreachable.
    """
    kind = faulty_bus.FaultyBus if station.faults.allowed else Bus
    return kind.join(station.cell_id, station.bus.endpoint, security=security, clock=clock_of(station))
