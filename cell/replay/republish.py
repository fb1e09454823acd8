"""Publishes a recorded cycle again, at its own pace, below ``replay/{cycle_id}/``, never on the keys of a live cell."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, NamedTuple

from mcap.records import Channel, Message, Schema

from bus import topics
from bus.commands import CellState, Nothing
from bus.errors import CellUnreachable, NoReply, Refused
from bus.session import Bus
from config.clock import clock_of
from config.schema import Station
from logs.mcap.content_reader import require_finished
from logs.mcap.finished_reader import records
from logs.mcap.names import reading
from logs.mcap.records import Damage

ROOT = "replay"
_LIVE_TIMEOUT_S = 1.0
_LOOK_S = 0.05
_NO_KEY = re.compile(r"//|[*$#?\0]")


class Payload(NamedTuple):
    """One recorded payload, unchanged.

    Attributes:
        log_time_ns: UTC. ``key``, ``encoding``: as published. ``data``: the bytes.
    """

    log_time_ns: int
    key: str
    encoding: str
    data: bytes


def payloads(path: Path) -> Iterator[Payload]:
    """All recorded payloads, in the order of the file. Raises: RecordingError."""
    require_finished(path)
    with reading(path), path.open("rb") as file:
        yield from _payloads(file)


def _payloads(file: IO[bytes]) -> Iterator[Payload]:
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    for record in records(file):
        match record:
            case Schema():
                schemas[record.id] = record.name
            case Channel():
                if _NO_KEY.search(f"/{record.topic.removeprefix('/')}/"):
                    raise Damage("a channel of it has a name that no payload can travel under")
                name = schemas.get(record.schema_id, "")
                channels[record.id] = record.topic.removeprefix("/"), f"application/{record.message_encoding};{name}"
            case Message():
                if record.channel_id not in channels:
                    raise Damage("a message of it belongs to no channel")
                yield Payload(record.log_time, *channels[record.channel_id], record.data)


def require_no_live_cell(station: Station) -> None:
    """Refuse while the recorded cell is running, to avoid confusion with it. Raises: Refused."""
    try:
        with Bus.join(station.cell_id, station.bus.endpoint, clock=clock_of(station)) as bus:
            bus.request(topics.STATE_NOW, Nothing(), CellState, timeout_s=_LIVE_TIMEOUT_S)
    except (CellUnreachable, NoReply):
        return
    raise Refused(
        f"The cell {station.cell_id!r} is live at {station.bus.endpoint}: its replay is not published beside it.",
        "Stop the cell first, or replay on another machine.",
        code="LIVE_CELL",
    )


def await_listener(bus: Bus, cycle_id: str, patience_s: float) -> None:
    """Wait up to ``patience_s`` for a subscriber of the replay; 0 = for none. Raises: NoReply when there is none."""
    if patience_s == 0:
        return
    pattern = f"{ROOT}/{cycle_id}/**"
    give_up_s = time.monotonic() + patience_s
    while not bus.is_heard(pattern):
        if time.monotonic() > give_up_s:
            raise NoReply(
                f"Nothing was published: nobody subscribed to {pattern!r} within {patience_s:g} s.",
                "Start the viewer first, or raise --wait-s; 0 publishes at once, whoever listens.",
            )
        time.sleep(_LOOK_S)


def republish(
    bus: Bus, cycle_id: str, said: list[Payload], rate: float, sleep: Callable[[float], None] = time.sleep
) -> Iterator[Payload]:
    """Publish every payload at its time, ``rate`` times as fast as recorded; yield each after publishing it.

    Args:
        rate: factor, dimensionless. ``sleep``: waits for a duration [s].
    """
    started_s = time.monotonic()
    for payload in said:
        due_s = started_s + (payload.log_time_ns - said[0].log_time_ns) / 1e9 / rate
        while (left_s := due_s - time.monotonic()) > 0:
            sleep(min(left_s, _LOOK_S))
        bus.put(f"{ROOT}/{cycle_id}/{payload.key}", payload.data, payload.encoding)
        yield payload
