"""A program's connection to a running cell: opened, asked and listened to; it commands nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from bus import topics
from bus.at_end import cancel_close_at_end, close_at_end
from bus.commands import CellHealth, CellState
from bus.errors import BusError, CellUnreachable, ConfigError, ReplyTimeout
from cell.cli.network.fleet import fleet
from cell.client import Client, client_name, connect
from cell.following import Said, next_message
from cell.machine.states import SETTLED
from config.schema import Station
from vlad_cell.station import Config, Settings, station_of


class Connection:
    """The part of a `Cell` that commands nothing; its arguments and errors are those of `Cell`."""

    def __init__(
        self,
        endpoint: str = "",
        *,
        cell_id: str = "",
        config: Config = None,
        settings: Settings | None = None,
        name: str = "python",
    ) -> None:
        named = {"endpoint": ("bus.endpoint", endpoint or None), "cell_id": ("cell_id", cell_id or None)}
        station = station_of(config, settings, named)
        if config is None and not cell_id and "cell_id" not in (settings or {}):
            station = station.model_copy(update={"cell_id": _only_cell(station)})
        with ExitStack() as stack:
            self._open(station, name, stack)
        self._require_this_cell()

    def _require_this_cell(self) -> None:
        """Refuse an endpoint at which another cell answers. Raises: CellUnreachable."""
        try:
            self._client.state()
        except CellUnreachable:
            self.close()
            raise
        except BusError:
            return  # it is there; each question says why it has no answer

    def _open(self, station: Station, name: str, stack: ExitStack) -> None:
        """Connect; what ``stack`` holds then belongs to this cell."""
        self._station = station
        self._client: Client = stack.enter_context(connect(station, (topics.EVENT,), client_id=client_name(name)))
        self._stack = stack.pop_all()
        close_at_end(self.close)

    def __repr__(self) -> str:
        return f"Cell {self._station.cell_id!r} at {self.endpoint}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the lease back and end the connection; a simulated cell ends, too. Idempotent."""
        cancel_close_at_end(self.close)
        self._stack.close()

    @property
    def endpoint(self) -> str:
        """The endpoint where the cell answers: for `Cell` elsewhere, or ``--set bus.endpoint=...`` of a command."""
        return self._station.bus.endpoint

    @property
    def station(self) -> Station:
        """The station that this program knows the cell by; that of a running cell is in its recordings."""
        return self._station

    def state(self) -> CellState:
        """Return what the cell does: ``state``, ``stage``, ``available`` commands, ``reason``. Raises: BusError."""
        return self._client.state()

    def health(self) -> CellHealth:
        """Return the health of the cell and its nodes. Raises: BusError."""
        return self._client.health()

    def events(self, timeout_s: float = 600.0) -> Iterator[Said]:
        """Yield what the cell says until it settles after something moved; who commanded it does not matter.

        Args:
            timeout_s: longest silence.

        Raises: ReplyTimeout after so long a silence; CellUnreachable when the cell is gone.
        """
        self._forget()
        moved = self.state().state not in SETTLED
        while (said := next_message(self._client, timeout_s)) is not None:
            yield said
            if isinstance(said, CellState):
                if moved and said.state in SETTLED:
                    return
                moved = moved or said.state not in SETTLED
        raise ReplyTimeout(f"The cell has said nothing for {timeout_s:.0f} s.", "See `cell status`.")

    def _forget(self) -> None:
        """Drop what was heard before now."""
        for _ in self._client.heard():
            pass


def _only_cell(station: Station) -> str:
    """The id of the only cell at the station's endpoint. Raises: CellUnreachable, ConfigError, BusError."""
    names = [member.cell_id for member in fleet(station)]
    if not names:
        raise CellUnreachable(f"No cell answers at {station.bus.endpoint}.", "Start it with `cell start`.")
    if len(names) > 1:
        raise ConfigError(
            f"Several cells answer at {station.bus.endpoint}.", f"Name one: cell_id, of {', '.join(names)}."
        )
    return names[0]
