"""Cycle after cycle with injected faults: was each outcome allowed by the fault table, and was the cell ready again?

`benchmarks.trials` defines the faults and the allowed outcomes. After each trial the faults end and the cell is cleared
and reset as an operator would. The daemon is a process of its own (`benchmarks.apart`), so its growth is measured
without that of reading the recordings here.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.apart import Apart, cell_apart
from benchmarks.door_faults import DoorFaults, door_settings
from benchmarks.growth import Grown, Growth
from benchmarks.trials import Outcome, Trial, explains, is_logged, rows_of, trials
from bus.commands import CommandRequest, Health, NodeHealth
from bus.errors import BusError, RecordingError, Refused
from bus.fault_injection import PARTS, Fault
from bus.messages import CycleResult
from cell import client
from cell.daemon.fault_table import DOORS
from cell.machine.owner import refuse
from config.load import load_station
from config.schema import Station
from logs.mcap.recorder import PART

NODE = "sim"
_DELAY_S = {"disk": 0.005}
_USUAL_DELAY_S = 0.15
_SIGNALS = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP}
_SETTLED = ("Complete", "Aborted", "Stopped")
_NEXT_COMMAND = {"Aborted": "clear", "Stopped": "reset", "Complete": "reset"}
_LOOK_S = 0.02
_PATIENCE_S = 180.0
"""A pick with no way to grasp is planned for longest."""
_QUICK = ("verify.hold_s=0.3", "verify.samples=2", "perception.hosted.deadline_s=0.3", "recording.patience_s=1.5",
          "arm.rest_s=4", "bus.stale_s=3", "bus.frozen_s=3.5", "bus.ask_timeout_s=8")  # fmt: skip
"""Deadlines as short as they may be: nothing waits for a fault longer than it must."""


def soak_station(folder: Path, endpoint: str, seed: int, overrides: tuple[str, ...] = ()) -> Station:
    """The simulated cell that allows faults, with short deadlines."""
    own = [f"recording.folder={folder}", f"bus.endpoint={endpoint}", f"sim.seed={seed}", "faults.allowed=true"]
    return load_station(None, [*own, *_QUICK, *door_settings(), *overrides])


class Soak:
    """One running cell, its operator, and the fault injector. Use `tried` after setting `cell`, `operator` and
    `doors`."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self.cell: Apart
        self.operator: client.Client
        self.doors: DoorFaults
        self._heard: queue.SimpleQueue[CycleResult] = queue.SimpleQueue()
        self._timer: threading.Thread | None = None

    def hear(self, result: CycleResult) -> None:
        """A cycle ended."""
        self._heard.put(result)

    def tried(self, trial: Trial) -> Outcome:
        """One cycle, and the way back to Idle."""
        started_s = time.monotonic()
        restarts = self._node().restarts
        while not self._heard.empty():  # what came too late to be the last trial's
            self._heard.get_nowait()
        if trial.row is not None:
            self.cell.expect(trial.moment, lambda: self._begin(trial))
        if trial.row is not None and trial.row.part in DOORS:
            self.doors.pick(trial.row.part)
        else:
            refuse(self.cell.command("pick", CommandRequest(client_id="soak", object=trial.object)))
        result, was_held = self._result()
        was_injected = trial.row is not None and self.cell.give_up()
        has_settled = self._wait(lambda: self._state() in _SETTLED)
        self.operator.release()
        if self._timer is not None:
            self._timer.join()
            self._timer = None
        code = result.code if result is not None else None
        explained = result is not None and explains(trial, was_injected, result, self.cell.objects_left)
        logged = result is not None and is_logged(result, trial)
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
            was_held=was_held,
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
        if row.part in DOORS:
            self.doors.inject(row.part, row.word)
        elif row.part == "node":
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
        if row.part in DOORS:
            return self.doors.heal(row.part, row.word)
        by_itself = row.part == "node" or (row.part, row.word) == ("bus", "off") or (trial.walk and row.then != "")
        if not by_itself:
            self._set(row.part, Fault.NONE)
        elif not self._wait(lambda: self._node().restarts > restarts):
            return False
        return self._wait(lambda: self._node().is_alive and self._node().said is not None)

    def _make_idle(self) -> bool:
        """Clear and reset, again if it must be, as an operator would."""
        give_up_s = time.monotonic() + _PATIENCE_S
        while (state := self._state()) != "Idle":
            if time.monotonic() > give_up_s:
                return False
            verb = _NEXT_COMMAND.get(state)
            if verb is not None and not self.cell.command(verb, CommandRequest(client_id="soak")).ok:
                time.sleep(0.1)
            time.sleep(_LOOK_S)
        return True

    # --- look ---------------------------------------------------------------------------------------------------------

    def _result(self) -> tuple[CycleResult | None, bool]:
        """The cycle's result, and whether the cell was held before; then it is told to go on."""
        was_held, give_up_s = False, time.monotonic() + _PATIENCE_S
        while time.monotonic() < give_up_s:
            with suppress(queue.Empty):
                return self._heard.get(timeout=_LOOK_S), was_held
            if self._state() == "Held":
                was_held = True
                with suppress(Refused):  # it goes on already
                    self.operator.command("unhold")
        return None, was_held

    def _state(self) -> str:
        return self.operator.state().state

    def _node(self) -> NodeHealth:
        return self.operator.health().nodes[NODE]

    def _said(self) -> Health:
        assert self._wait(lambda: self._node().said is not None)
        said = self._node().said
        assert said is not None
        return said

    def look(self, growth: Growth) -> None:
        """Look at the daemon's process, and at its node's. To be called while the cell is Idle."""
        said = self._node().said
        growth.look(self.cell.pid, said.pid if said is not None else None)

    def _wait(self, condition: Callable[[], bool]) -> bool:
        give_up_s = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > give_up_s:
                return False
            time.sleep(_LOOK_S)
        return True


_PART_OF = {str(part): part for part in PARTS}


def soak(station: Station, series: Iterator[Trial], growth: Growth) -> Iterator[Outcome]:
    """Every trial's outcome; a cell that is stuck is started anew."""
    while True:
        run = Soak(station)
        with (
            cell_apart(station, run.hear) as run.cell,
            client.connect(station) as run.operator,
            closing(DoorFaults(station)) as run.doors,
        ):
            assert run.make_idle(), "the cell does not become ready"
            for trial in series:
                outcome = run.tried(trial)
                yield outcome
                if not outcome.is_idle:
                    break
                run.look(growth)


def run(
    cycles: int,
    faults: str,
    seed: int,
    endpoint: str,
    state: Path | None,
    tell: Callable[[str], None],
    overrides: tuple[str, ...] = (),
    keep: Path | None = None,
) -> dict[str, Any]:
    """``cycles`` cycles; with ``state``, a file, those of an interrupted run of the same are not repeated.

    Args:
        keep: the folder that all recordings lie in, and stay; else only those of what was not as it should be.
    """
    settings = {"faults": faults, "seed": seed}
    kept: dict[str, Any] = json.loads(state.read_text()) if state is not None and state.exists() else {}
    if kept.get("settings", settings) != settings:
        raise RecordingError(f"{state} is of another soak: {kept['settings']}.", "Name another file.")
    outcomes = [Outcome(**one) for one in kept.get("outcomes", ())]
    daemon, node = (_grown(kept.get("growth", {}).get(name, {})) for name in ("daemon", "node"))
    growth = Growth(daemon, node)
    with TemporaryDirectory() as folder:
        station = soak_station(keep or Path(folder), endpoint, seed, overrides)
        series = soak(station, trials(rows_of(faults), seed, len(outcomes)), growth)
        while len(outcomes) < cycles:
            outcomes.append(next(series))
            tell(outcomes[-1].line())
            if keep is None:
                _forget(outcomes[-1])
            if state is not None:
                grown = {"daemon": asdict(growth.daemon), "node": asdict(growth.node)}
                _keep(state, {"settings": settings, "outcomes": [asdict(one) for one in outcomes], "growth": grown})
        series.close()  # type: ignore[attr-defined]
    return summary(outcomes, growth)


def _forget(outcome: Outcome) -> None:
    """A good cycle's recording is not kept: a thousand would fill the disk."""
    path = Path(outcome.recording)
    if outcome.is_logged and outcome.is_explained:
        path.unlink(missing_ok=True)
        path.with_name(path.name + PART).unlink(missing_ok=True)


def _grown(kept: dict[str, dict[str, float]]) -> Grown:
    """Return what an interrupted run has found; JSON's keys are words."""
    rss_mb, fds = ({int(pid): by for pid, by in kept.get(name, {}).items()} for name in ("rss_mb", "fds"))
    return Grown(rss_mb, fds)


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
        "rss_growth_mb": growth.daemon.worst_rss_mb(),
        "node_rss_growth_mb": growth.node.worst_rss_mb(),
        "fd_growth": max(growth.daemon.worst_fds(), growth.node.worst_fds()),
        "cases": [one.line() for one in bad],
    }
