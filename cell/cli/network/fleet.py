"""``cell fleet``: all reachable cells and their states; ``cell router``: the Zenoh router that connects them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

import zenoh

from bus import topics
from bus.codec import decode
from bus.commands import CellHealth, CellState, Nothing
from bus.errors import BadPayload, PortOccupied
from bus.frozen import Message
from bus.secured import session_config
from bus.session import Bus
from cell.terminal.signals import on_end
from config.clock import clock_of
from config.schema import Station

_EVERY = "*"
_LONGEST_NS = 10**18  # the stamp of another program may have any size
MessageT = TypeVar("MessageT", bound=Message)


class Member(NamedTuple):
    """One cell of the fleet.

    Attributes:
        state: None = its answer could not be decoded. ``health``: None = it gave no answer.
    """

    cell_id: str
    state: CellState | None
    health: CellHealth | None

    @property
    def problems(self) -> list[str]:
        """All problems of its nodes, its doors and its own process."""
        if self.health is None:
            return ["health unknown"]
        return self.health.problems

    def line(self, now_ns: int) -> str:
        """One line for a person: name, state, stage, duration and problems. ``now_ns``: UTC."""
        if self.state is None:
            return f"{self.cell_id:<16} ?            it speaks another version"
        state = self.state
        since = _duration(min(max(0, now_ns - state.since_ns), _LONGEST_NS) * 1e-9)
        said = "; ".join([*([state.reason] if state.reason else []), *self.problems]) or "healthy"
        return f"{self.cell_id:<16} {state.state:<12} {state.stage:<8} {since:>6}  {said}"

    def to_json(self) -> dict[str, object]:
        """Return the fields as a JSON object."""
        return {
            "cell_id": self.cell_id,
            "state": self.state.model_dump(mode="json") if self.state else None,
            "is_healthy": self.health.is_healthy if self.health else None,
            "problems": self.problems,
        }


def fleet(station: Station) -> list[Member]:
    """All cells that answer at the station's ``bus.endpoint``, by name. Raises: CellUnreachable; ConfigError."""
    settings = station.bus
    with Bus.join(_EVERY, settings.endpoint, security=settings.zenoh, clock=clock_of(station)) as bus:
        states = bus.survey(topics.STATE_NOW, Nothing(), timeout_s=settings.ask_timeout_s)
        healths = bus.survey(topics.HEALTH_NOW, Nothing(), timeout_s=settings.ask_timeout_s)
    return [
        Member(cell_id, _or_none(CellState, states[cell_id]), _or_none(CellHealth, healths.get(cell_id, b"")))
        for cell_id in sorted(states)
    ]


def route(file: Path, tell: Callable[[str], None]) -> None:
    """Run a Zenoh router in this process until it is asked to end.

    Args:
        tell: called with a line for the operator.

    Raises: ConfigError when ``file`` is not safe; PortOccupied.
    """
    config = session_config("router", listen=None, connect=None, file=file)
    ended = threading.Event()
    on_end(ended.set)
    endpoints = config.get_json("listen/endpoints")
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise PortOccupied(
            f"Cannot listen on {endpoints}: another program uses it, or it is not this machine's address.",
            "End that program, or name another endpoint in the file.",
        ) from error
    with session:
        tell(f"router on {endpoints}; Ctrl-C ends")
        ended.wait()


def _or_none(kind: type[MessageT], payload: bytes) -> MessageT | None:
    try:
        return decode(kind, payload)
    except BadPayload:
        return None


def _duration(seconds: float) -> str:
    for size_s, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= size_s:
            return f"{seconds / size_s:.0f} {unit}"
    return f"{seconds:.0f} s"
