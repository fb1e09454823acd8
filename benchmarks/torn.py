"""What a process killed at any moment leaves of its cycle: everything up to its last flush, in a file that can be read.

Most kills hit a process that only records, as fast as its disk takes it; the truth is what it reported over a pipe
after each flush. Some hit a whole simulated cell in the middle of a pick; there it is what a client on the bus heard.
"""

from __future__ import annotations

import itertools
import multiprocessing
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mcap.reader import make_reader

from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.errors import CellUnreachable, RecordingError
from bus.heard import Heard
from bus.messages import HandState
from bus.session import Bus
from bus.topics import encoding_of
from cell.cyclelog import CycleLog
from config.load import load_station
from logs.reader import read_cycle
from logs.recorder import Recorder
from logs.recover import recover

_PATIENCE_S = 30.0
_LONGEST_S = 0.5
"""A recording lives for this long at most before it is killed: five periods of flushing."""
_FLUSHED_AFTER_S = 0.5
"""What a client heard of a cell's cycle this long before the kill must be there: a flush, and a busy machine."""
_STAGES = {topic.key for topic in (topics.CAPTURE, topics.DETECT, topics.PLAN, topics.EXECUTE, topics.VERIFY)}


def run(kills: int, cells: int, seed: int, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """``kills`` in all, ``cells`` of them of a whole cell."""
    rng = random.Random(seed)
    lost = unreadable = flushed = 0
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
            missing, readable = _kill_cell(Path(name) / f"cell{number}", endpoint, rng, tell)
            lost += missing
            unreadable += not readable
    return {"kills": kills, "lost": lost, "unreadable": unreadable, "flushed": flushed, "of_cells": cells}


def _recovered(path: Path) -> int | None:
    """How many messages came back, in order and without a gap; None when the file cannot be read."""
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
    """How many messages it had reported as flushed when it was killed."""
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
        Heard(topics.HAND_STATE.key, encoding_of(HandState), encode(hand)),
        Heard(topics.STATE.key, encoding_of(CellState), encode(state)),
        Heard(topics.CAMERA_DEPTH.key, encoding_of(topics.CAMERA_DEPTH.says), noise),
    )
    while True:
        log.hear(rng.choices(says, (20, 1, 4))[0])
        time.sleep(rng.uniform(0.0, 0.004))


# --- a whole cell -----------------------------------------------------------------------------------------------------


def _kill_cell(folder: Path, endpoint: str, rng: random.Random, tell: Callable[[str], None]) -> tuple[int, bool]:
    """Kill a simulated cell in its first pick: how many stages a client had heard that are missing; readable?"""
    settings = (f"recording.folder={folder}", f"bus.endpoint={endpoint}", "bus.stale_s=15")
    command = [sys.executable, "-m", "cell", "start", "--cycles", "1", "--json"]
    process = subprocess.Popen(
        [*command, *(part for setting in settings for part in ("--set", setting))], stdout=subprocess.DEVNULL
    )
    heard: list[tuple[float, str]] = []
    with _joined(endpoint) as bus:
        bus.subscribe("cycle/*", lambda said: heard.append((time.monotonic(), said.key)))
        after = rng.randrange(1, len(_STAGES))
        give_up_s = time.monotonic() + 120.0
        while len(heard) < after and process.poll() is None and time.monotonic() < give_up_s:
            time.sleep(0.005)
        time.sleep(rng.uniform(0.0, 1.5))
        process.send_signal(signal.SIGKILL)
        killed_s = time.monotonic()
        process.wait()
    expected = {key.rpartition("/")[2] for at_s, key in heard if key in _STAGES and at_s < killed_s - _FLUSHED_AFTER_S}
    parts = list(folder.rglob("*.mcap*"))
    try:
        for part in folder.rglob("*.part"):
            recover(part)
        (recording,) = folder.rglob("*.mcap")
        found = set(read_cycle(recording).stages)
    except (RecordingError, ValueError) as error:
        tell(f"cell killed after {len(heard)} stages: {parts}: {error}")
        return len(expected), False
    tell(f"cell killed after {len(heard)} stages: {len(expected - found)} of {len(expected)} lost")
    return len(expected - found), True


def _joined(endpoint: str) -> Bus:
    give_up_s = time.monotonic() + 60.0
    while True:
        try:
            return Bus.join(load_station().cell_id, endpoint)
        except CellUnreachable:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.1)
