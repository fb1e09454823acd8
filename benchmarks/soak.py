"""Cycle after cycle with injected faults: was each outcome one the fault table allows, and was the cell ready again?

The first cycles walk through every row of `cell.faults`; then parts, words and moments are drawn at random, and every
fourth cycle has no fault. After each the faults end and the cell is cleared and reset as an operator would.
"""

from __future__ import annotations

import gc
import json
import os
import queue
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.records import Attachment
from mcap.stream_reader import StreamReader

from bus.codes import Code
from bus.commands import CellState, CommandRequest, Health
from bus.errors import BusError, RecordingError, Refused
from bus.faults import PARTS, Fault
from bus.frozen import Message
from bus.messages import CycleResult
from bus.topics import Topic
from cell import client
from cell.build import running_cell
from cell.daemon import Daemon
from cell.faults import PICK_CODES, ROWS, Row
from cell.machine import refuse
from config.load import load_station
from config.schema import Station
from logs.reader import DAMAGE, read_cycle
from logs.recorder import PART

MOMENTS = ("begin", "capture", "detect", "plan", "execute", "verify", "deliver")
NODE = "sim"
_WITHOUT_FAULT = 0.25
_OBJECTS = ("bottle", "spatula", "controller", "cup", "drone")
"""The first is on the table from the start: presenting another one makes the simulator compile it."""
_DELAY_S = {"disk": 0.005}
_USUAL_DELAY_S = 0.15
_SIGNALS = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP}
_SETTLED = ("Complete", "Aborted", "Stopped")
_NEXT_COMMAND = {"Aborted": "clear", "Stopped": "reset", "Complete": "reset"}
_PATIENCE_S = 180.0
"""A pick with no way to grasp is planned for longest."""
_WARM_UP = 20
_QUICK = ("verify.hold_s=0.3", "verify.samples=2", "perception.hosted.deadline_s=0.3", "recording.patience_s=1.5",
          "arm.rest_s=4", "bus.stale_s=3", "bus.frozen_s=3.5", "bus.ask_timeout_s=8")  # fmt: skip
"""Deadlines as short as they may be: nothing waits for a fault longer than it must."""


@dataclass(frozen=True)
class Trial:
    """One cycle to be: ``row`` None = without a fault; ``late_s``: after the moment began; ``walk``: the row's own."""

    number: int
    row: Row | None
    moment: str
    late_s: float
    object: str
    walk: bool


@dataclass(frozen=True)
class Outcome:
    """What came of one trial.

    Attributes:
        fault: the row's name, or "". ``result``, ``code``, ``reason``: of the cycle; "NONE" when none was said.
        is_explained, is_logged, is_idle: as the table allows; with a readable record; ready again in time.
        took_s: the cycle, and the way back to Idle. ``recording``: its path.
    """

    number: int
    fault: str
    moment: str
    result: str
    code: str
    reason: str
    is_explained: bool
    is_logged: bool
    is_idle: bool
    took_s: float
    recording: str

    def line(self) -> str:
        marks = "".join(f" {word}" for word, good in (("UNEXPLAINED", self.is_explained), ("UNLOGGED", self.is_logged),
                                                      ("STUCK", self.is_idle)) if not good)  # fmt: skip
        what = f"{self.fault or '-'} @{self.moment}"
        return f"{self.number} {what}: {self.result} {self.code} {self.took_s:.1f} s{marks}  {self.reason}"


def soak_station(folder: Path, endpoint: str, seed: int, overrides: tuple[str, ...] = ()) -> Station:
    """The simulated cell that allows faults, with short deadlines."""
    own = [f"recording.folder={folder}", f"bus.endpoint={endpoint}", f"sim.seed={seed}", "faults.allowed=true"]
    return load_station(None, [*own, *_QUICK, *overrides])


def trials(rows: tuple[Row, ...], seed: int, first: int) -> Iterator[Trial]:
    """The endless series, from number ``first`` (0 = the first); each depends on seed and number only."""
    number = first
    while True:
        rng = np.random.default_rng([seed, number])
        if number < len(rows):
            yield Trial(number, rows[number], rows[number].sets_in, 0.0, _OBJECTS[0], True)
        else:
            row = None if rng.random() < _WITHOUT_FAULT or not rows else rows[int(rng.integers(len(rows)))]
            late_s = float(rng.uniform(0.0, 0.5)) if rng.random() < 0.5 else 0.0
            moment = str(rng.choice(MOMENTS)) if row is not None else ""
            yield Trial(number, row, moment, late_s, str(rng.choice(_OBJECTS)), False)
        number += 1


class Soak:
    """One running cell, its operator, and whoever injects. Use `tried` after setting `daemon` and `operator`."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self.daemon: Daemon
        self.operator: client.Client
        self._heard: queue.SimpleQueue[CycleResult] = queue.SimpleQueue()
        self._due: Trial | None = None
        self._timer: threading.Thread | None = None

    def observe(self, _topic: Topic, message: Message | bytes) -> None:
        """On the daemon's own threads: what is due now is in place before the cell goes on."""
        if isinstance(message, CycleResult):
            self._heard.put(message)
        elif isinstance(message, CellState):
            moment, due = "begin" if message.state == "Starting" else message.stage, self._due
            if due is not None and due.moment == moment:
                self._due = None
                self._begin(due)

    def tried(self, trial: Trial) -> Outcome:
        """One cycle, and the way back to Idle."""
        started_s = time.monotonic()
        restarts = self._node().restarts
        while not self._heard.empty():  # what came too late to be the last trial's
            self._heard.get_nowait()
        self._due = trial if trial.row is not None else None
        refuse(self.daemon.command("pick", CommandRequest(client_id="soak", object=trial.object)))
        result = self._result()
        was_injected = trial.row is not None and self._due is None
        self._due = None
        has_settled = self._wait(lambda: self.daemon.machine.state in _SETTLED)
        if self._timer is not None:
            self._timer.join()
            self._timer = None
        code = result.code if result is not None else None
        explained = result is not None and self._explains(trial, was_injected, result)
        logged = result is not None and _is_logged(result, trial)
        is_back = self._heal(trial, restarts) if was_injected else True
        is_idle = has_settled and is_back and self._make_idle()
        return Outcome(
            number=trial.number,
            fault=trial.row.name if trial.row is not None else "",
            moment=f"{trial.moment}+{trial.late_s:.2f}" if trial.late_s else trial.moment,
            result=result.result if result is not None else "NONE",
            code=str(code or ""),
            reason=result.reason if result is not None else "no result was said",
            is_explained=explained,
            is_logged=logged,
            is_idle=is_idle,
            took_s=time.monotonic() - started_s,
            recording=result.recording if result is not None else "",
        )

    def make_idle(self) -> bool:
        """After the start. False when it does not come."""
        return self._make_idle()

    # --- inject and heal ----------------------------------------------------------------------------------------------

    def _begin(self, trial: Trial) -> None:
        if trial.late_s == 0.0:
            self._inject(trial)
            return
        self._timer = threading.Timer(trial.late_s, self._inject, args=(trial,))
        self._timer.start()

    def _inject(self, trial: Trial) -> None:
        row = trial.row
        assert row is not None
        if row.part == "node":
            os.kill(self._said().pid, _SIGNALS[row.word])
        else:
            self._set(row.part, Fault(row.word))

    def _set(self, part: str, fault: Fault) -> bool:
        """False when nobody is there to be told."""
        try:
            self.operator.fault(_PART_OF[part], fault, _DELAY_S.get(part, _USUAL_DELAY_S))
        except (Refused, BusError):
            return False
        return True

    def _heal(self, trial: Trial, restarts: int) -> bool:
        """The fault ends; where the cell is to bring its node back by itself, in that."""
        row = trial.row
        assert row is not None
        by_itself = row.part == "node" or (row.part, row.word) == ("bus", "off") or (trial.walk and row.then != "")
        if not by_itself:
            self._set(row.part, Fault.NONE)
        elif not self._wait(lambda: self._node().restarts > restarts):
            return False
        return self._wait(lambda: self._node().is_alive and self._node().said is not None)

    def _make_idle(self) -> bool:
        """Clear and reset, again if it must be, as an operator would."""
        give_up_s = time.monotonic() + _PATIENCE_S
        while (state := str(self.daemon.machine.state)) != "Idle":
            if time.monotonic() > give_up_s:
                return False
            verb = _NEXT_COMMAND.get(state)
            if verb is not None and not self.daemon.command(verb, CommandRequest(client_id="soak")).ok:
                time.sleep(0.1)
            time.sleep(0.01)
        return True

    # --- look ---------------------------------------------------------------------------------------------------------

    def _explains(self, trial: Trial, was_injected: bool, result: CycleResult) -> bool:
        """Whether the table allows it; a SUCCESS also has to be one."""
        if result.result == "SUCCESS" and self.daemon.objects_left() not in (0, None):
            return False
        if result.result not in ("SUCCESS", "EMPTY") and result.code in (None, Code.INTERNAL):
            return False
        if trial.walk and trial.row is not None:
            return (result.result, result.code) == (trial.row.result, trial.row.code)
        if trial.row is None or not was_injected:
            return result.result in ("SUCCESS", "FAILED") and result.code in (None, *PICK_CODES)
        return result.code in trial.row.allowed | set(PICK_CODES if result.result == "FAILED" else ())

    def _result(self) -> CycleResult | None:
        try:
            return self._heard.get(timeout=_PATIENCE_S)
        except queue.Empty:
            return None

    def _node(self) -> Any:
        return self.daemon.health().nodes[NODE]

    def _said(self) -> Health:
        assert self._wait(lambda: self._node().said is not None)
        said: Health = self._node().said
        return said

    def pids(self) -> list[int]:
        """Of the daemon (this process) and its node."""
        said = self._node().said
        return [os.getpid(), *([said.pid] if said is not None else [])]

    def _wait(self, condition: Callable[[], bool]) -> bool:
        give_up_s = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > give_up_s:
                return False
            time.sleep(0.01)
        return True


_PART_OF = {str(part): part for part in PARTS}


def _is_logged(result: CycleResult, trial: Trial) -> bool:
    """A recording that says the same; after a fault of the disk, what was written before, if anything could be."""
    path = Path(result.recording)
    if result.code is not Code.RECORDING:
        try:
            recorded = read_cycle(path).result
        except RecordingError:
            return False
        return recorded is not None and (recorded.result, recorded.code) == (result.result, result.code)
    if trial.moment == "begin" or (trial.row is not None and trial.row.word == "garbage"):
        return True
    try:
        with path.with_name(path.name + PART).open("rb") as file:
            return any(isinstance(record, Attachment) for record in StreamReader(file).records)
    except DAMAGE:
        return False


class Growth:
    """Memory and open files of some processes, against what they were after a warm-up."""

    def __init__(self) -> None:
        self._first: dict[int, tuple[int, float, int]] = {}  # looks so far, and the first figures after the warm-up
        self.rss_mb = 0.0
        self.fds = 0

    def look(self, pids: list[int]) -> None:
        """To be called while the cell is Idle."""
        gc.collect()
        for pid in pids:
            looks, rss_mb, fds = self._first.get(pid, (0, 0.0, 0))
            now = _rss_mb(pid), len(os.listdir(f"/proc/{pid}/fd"))
            if looks <= _WARM_UP:
                rss_mb, fds = now
            else:
                self.rss_mb, self.fds = max(self.rss_mb, now[0] - rss_mb), max(self.fds, now[1] - fds)
            self._first[pid] = looks + 1, rss_mb, fds


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def soak(station: Station, series: Iterator[Trial], growth: Growth) -> Iterator[Outcome]:
    """Every trial's outcome; a cell that is stuck is started anew."""
    while True:
        run = Soak(station)
        with running_cell(station, run.observe) as daemon, client.connect(station) as operator:
            run.daemon, run.operator = daemon, operator
            assert run.make_idle(), "the cell does not become ready"
            for trial in series:
                outcome = run.tried(trial)
                yield outcome
                if not outcome.is_idle:
                    break
                growth.look(run.pids())


def rows_of(faults: str) -> tuple[Row, ...]:
    """``all``, ``none``, or parts separated by commas."""
    if faults in ("all", "none"):
        return ROWS if faults == "all" else ()
    return tuple(row for row in ROWS if row.part in faults.split(","))


def run(
    cycles: int,
    faults: str,
    seed: int,
    endpoint: str,
    state: Path | None,
    tell: Callable[[str], None],
    overrides: tuple[str, ...] = (),
) -> dict[str, Any]:
    """``cycles`` cycles; with ``state``, a file, those of an interrupted run of the same are not repeated."""
    settings = {"faults": faults, "seed": seed}
    kept: dict[str, Any] = json.loads(state.read_text()) if state is not None and state.exists() else {}
    if kept.get("settings", settings) != settings:
        raise RecordingError(f"{state} is of another soak: {kept['settings']}.", "Name another file.")
    outcomes = [Outcome(**one) for one in kept.get("outcomes", ())]
    growth = Growth()
    growth.rss_mb, growth.fds = kept.get("rss_growth_mb", 0.0), kept.get("fd_growth", 0)
    with TemporaryDirectory() as folder:
        station = soak_station(Path(folder), endpoint, seed, overrides)
        series = soak(station, trials(rows_of(faults), seed, len(outcomes)), growth)
        while len(outcomes) < cycles:
            outcomes.append(next(series))
            tell(outcomes[-1].line())
            _forget(outcomes[-1])
            if state is not None:
                figures = {"rss_growth_mb": growth.rss_mb, "fd_growth": growth.fds}
                _keep(state, {"settings": settings, "outcomes": [asdict(one) for one in outcomes], **figures})
        series.close()  # type: ignore[attr-defined]
    return summary(outcomes, growth)


def _forget(outcome: Outcome) -> None:
    """A good cycle's recording is not kept: a thousand would fill the disk."""
    path = Path(outcome.recording)
    if outcome.is_logged and outcome.is_explained:
        path.unlink(missing_ok=True)
        path.with_name(path.name + PART).unlink(missing_ok=True)


def _keep(state: Path, progress: dict[str, Any]) -> None:
    part = state.with_name(state.name + ".new")
    part.write_text(json.dumps(progress))
    part.replace(state)


def summary(outcomes: list[Outcome], growth: Growth) -> dict[str, Any]:
    """The figures; ``cases``: what was not as it should be, in words."""
    bad = [one for one in outcomes if not (one.is_explained and one.is_logged and one.is_idle)]
    return {
        "cycles": len(outcomes),
        "by_result": Counter(one.result for one in outcomes),
        "by_code": Counter(one.code for one in outcomes if one.code),
        "injected": Counter(one.fault for one in outcomes if one.fault),
        "unexplained": sum(not one.is_explained for one in outcomes),
        "stuck_states": sum(not one.is_idle for one in outcomes),
        "unlogged_cycles": sum(not one.is_logged for one in outcomes),
        "rss_growth_mb": round(growth.rss_mb, 1),
        "fd_growth": growth.fds,
        "cases": [one.line() for one in bad],
    }
