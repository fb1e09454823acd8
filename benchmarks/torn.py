"""The recording of a process killed at any moment: everything up to its last flush, in a readable file.

Most kills hit a process that only records, as fast as its disk allows; the reference is the count it reported over a
pipe after each flush. Some hit a whole simulated cell (`benchmarks.killed`).
"""

from __future__ import annotations

import itertools
import multiprocessing
import random
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mcap.reader import make_reader

from benchmarks import damaged
from benchmarks.killed import kill_cell
from benchmarks.started import recorded_cycle
from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.errors import RecordingError
from bus.messages import HandState
from bus.sample import Sample
from bus.topics import encoding_of
from cell.pick.record import CycleLog
from logs.mcap.recorder import Recorder
from logs.mcap.recover import recover

_PATIENCE_S = 30.0
_LONGEST_S = 0.5
"""A recording lives for this long at most before it is killed: five periods of flushing."""


def run(kills: int, cells: int, damages: int, seed: int, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """``kills`` in all, ``cells`` of them of a whole cell; and one recorded cycle, damaged ``damages`` times."""
    rng = random.Random(seed)
    lost = unreadable = flushed = not_ready = 0
    with TemporaryDirectory() as name:
        for number in range(kills - cells):
            path = Path(name) / f"{number}.mcap"
            reported = _kill_writer(path, rng)
            kept = _recovered(path)
            flushed += reported
            unreadable += kept is None
            lost += max(0, reported - (kept or 0))
            path.unlink(missing_ok=True)
            if number % 20 == 19:
                tell(f"{number + 1} killed: {lost} lost of {flushed} flushed, {unreadable} unreadable")
        for number in range(cells):
            left = kill_cell(Path(name) / f"cell{number}", endpoint, rng)
            tell(left.line())
            lost += left.lost
            unreadable += not left.is_readable
            not_ready += not left.is_ready
        damage = damaged.run(recorded_cycle(Path(name) / "whole", endpoint), damages, seed) if damages else {}
    figures = {"kills": kills, "lost": lost, "unreadable": unreadable, "flushed": flushed}
    figures |= {"of_cells": cells, "cells_not_ready_again": not_ready}
    return {**figures, "damaged_percent_kept": damage}


def _recovered(path: Path) -> int | None:
    """Return how many messages came back, in order and without a gap; None when the file cannot be read."""
    try:
        recover(path.with_name(path.name + ".part"))
    except RecordingError:
        return None
    with path.open("rb") as file:
        numbers = [message.log_time for *_, message in make_reader(file, validate_crcs=True).iter_messages()]
    first = min(numbers, default=0)
    return next((index for index, number in enumerate(sorted(numbers)) if number != first + index), len(numbers))


# --- a process that only records --------------------------------------------------------------------------------------


def _kill_writer(path: Path, rng: random.Random) -> int:
    """Kill a writer, and return how many messages it had reported as flushed."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["benchmarks.torn"])
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_record, args=(path, theirs, rng.random()))
    process.start()
    theirs.close()
    ours.recv()
    time.sleep(rng.uniform(0.0, _LONGEST_S))
    process.kill()
    process.join()
    reported = 0
    try:
        while True:
            reported = ours.recv()
    except (EOFError, OSError):  # nothing more was said
        ours.close()
    return reported


def _record(path: Path, told: Connection, seed: float) -> None:
    """Records until killed: joints and hand often, states and stages now and then, images in between."""

    class Telling(Recorder):
        written = 0

        def write(self, key: str, encoding: str, payload: bytes, *, log_time_ns: int) -> None:
            super().write(key, encoding, payload, log_time_ns=log_time_ns)
            self.written += 1

        def flush(self) -> None:
            super().flush()
            told.send(self.written)

    def open_recorder() -> Recorder:
        recorder = Telling(path, metadata={"cycle_id": path.stem}, clock=lambda: 1)
        recorder.attach("station.json", "application/json", b"{}")
        return recorder

    rng = random.Random(seed)
    clock = itertools.count(1)
    log = CycleLog(open_recorder, path, _PATIENCE_S, lambda: next(clock))
    hand = HandState(stamp_ns=0, width_m=0.04, is_moving=False, is_homed=True)
    state = CellState(state="Execute", stage="", cycle_id="", since_ns=1, available=(), reason="")
    noise = rng.randbytes(200_000)
    says = (
        Sample(topics.HAND_STATE.key, encoding_of(HandState), encode(hand)),
        Sample(topics.STATE.key, encoding_of(CellState), encode(state)),
        Sample(topics.CAMERA_DEPTH.key, encoding_of(topics.CAMERA_DEPTH.says), noise),
    )
    while True:
        log.hear(rng.choices(says, (20, 1, 4))[0])
        time.sleep(rng.uniform(0.0, 0.004))
