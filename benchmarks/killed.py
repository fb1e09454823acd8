"""A whole simulated cell whose daemon is killed at any moment: the content of its recordings, and its recovery.

The reference is the list of stages that a client on the bus received before the kill.
"""

from __future__ import annotations

import json
import random
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from benchmarks.openness import trouble
from benchmarks.started import cell_started
from benchmarks.stopping import make_idle
from bus.errors import BusError, RecordingError, Refused
from bus.sample import Sample
from bus.session import Bus
from cell import client
from cell.replay.compared_stages import STAGES
from config.load import load_station
from logs.mcap.reader import read_cycle

_LATEST_S = 9.0
"""From the first command: the reset, the pick, and some time after."""
_FLUSHED_AFTER_S = 0.5
"""Messages heard this long before the kill must be there: a flush, and a busy machine."""
_PATIENCE_S = 90.0
_STAGE_KEYS: dict[str, str] = {stage.topic.key: stage.name for stage in STAGES}

Stages = set[tuple[str, str]]
"""(cycle id, stage)."""


class Left(NamedTuple):
    """The remains of a killed cell.

    Attributes:
        moment: of the kill, in words. ``reason``: why it is not as it should be, or "".
        lost: stages that were heard, and are in no recording.
        is_readable: every recording, after the next start. ``is_ready``: then it was cleared and reset like any other.
    """

    moment: str
    lost: int
    is_readable: bool
    is_ready: bool
    reason: str

    def line(self) -> str:
        words = (f"{self.lost} stages lost", "readable" if self.is_readable else "NOT READABLE",
                 "ready again" if self.is_ready else "NOT READY AGAIN", self.reason)  # fmt: skip
        return f"cell killed {self.moment}: {', '.join(filter(None, words))}"


def kill_cell(folder: Path, endpoint: str, rng: random.Random) -> Left:
    """Kill a cell between its first reset and the end of its first pick, and start it again on the same folder."""
    overrides = [f"recording.folder={folder}", f"bus.endpoint={endpoint}", "bus.stale_s=15"]
    heard, moment = _picks_until_killed(overrides, rng.uniform(0.0, _LATEST_S))
    not_ready = _is_made_ready(overrides)
    try:
        lost, unreadable = len(heard - _recorded(folder)), ""
    except RecordingError as error:
        lost, unreadable = len(heard), str(error)
    return Left(moment, lost, not unreadable, not not_ready, f"{unreadable} {not_ready}".strip())


def _picks_until_killed(overrides: list[str], after_s: float) -> tuple[Stages, str]:
    """Return what was heard long enough before the kill; and where the cell was then, as far as it had said so."""
    station = load_station(None, overrides)
    heard: list[tuple[float, Sample]] = []
    with cell_started(overrides) as process, Bus.join(station.cell_id, station.bus.endpoint) as bus:
        for key in ("cycle/*", "state"):
            bus.subscribe(key, lambda said: heard.append((time.monotonic(), said)))
        killer = threading.Timer(after_s, process.kill)
        killer.start()
        with suppress(BusError, Refused), client.connect(station) as operator:  # the kill may come at any of these
            operator.command("reset")
            operator.wait_for_state({"Idle"}, _PATIENCE_S)
            operator.command("pick")
            process.wait()
        killer.join()
        killed_s = time.monotonic()
    states = [json.loads(said.payload) for at_s, said in heard if said.key == "state" and at_s < killed_s]
    where = f"in {states[-1]['state']} {states[-1]['stage']}".rstrip() if states else "before its first state"
    stages = {
        (json.loads(said.payload)["cycle_id"], _STAGE_KEYS[said.key])
        for at_s, said in heard
        if said.key in _STAGE_KEYS and at_s < killed_s - _FLUSHED_AFTER_S
    }
    return stages, f"{after_s:.1f} s after its first command, {where}"


def _is_made_ready(overrides: list[str]) -> str:
    """Start the cell again, clear and reset it as an operator would, end it. Why that failed, or ""."""
    with cell_started(overrides) as process:
        try:
            with client.connect(load_station(None, overrides)) as operator:
                make_idle(operator)
        except (BusError, Refused) as error:
            return str(error)
        process.terminate()
        code = process.wait(_PATIENCE_S)
    return "" if code == 0 else f"It ended with {code}."


def _recorded(folder: Path) -> Stages:
    """Raises: RecordingError for a file that cannot be read, or was not recovered."""
    parts = [path.name for path in folder.rglob("*.part")]
    if parts:
        raise RecordingError(f"Not recovered: {', '.join(parts)}.")
    paths = list(folder.rglob("*.mcap"))
    for path in paths:
        if why := trouble(path):
            raise RecordingError(why)
    records = [read_cycle(path) for path in paths]
    return {(record.cycle_id, stage) for record in records for stage in record.stages}
