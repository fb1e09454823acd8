"""Time until the arm brakes, and rests, after a command, a lost lease or a frozen node, during a real pick.

Brake: the first control tick (1 kHz) whose command departs from the planned motion. Its wall time comes from the arm's
published states, matched with the motion's own samples: the simulated arm plays ten ticks at a time, so a figure may be
up to 10 ms too long, or its instant that much too early. An arm that slows down by plan may already brake at its limit
without departing from the plan: such a pick is repeated. Rest: the first published state after which no joint is faster
than `REST_RAD_S`. The lease is lost by the SIGKILL of the process that holds it.

A node that is frozen (SIGSTOP) cannot brake its arm, and cannot be measured: in simulation the frozen arm does not
move. Measured are ``noticed_ms``, from SIGSTOP until the cell aborts, and, after the node continues (SIGCONT, right
after that), ``rest_s`` until its arm rests. For a frozen daemon or client see `benchmarks.freezing`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from benchmarks.openness import trouble
from bus import topics
from bus.frozen import Message
from bus.messages import CycleResult, Execution, PickPlan, StageRecord
from bus.sample import Sample
from bus.session import Bus
from bus.topics import Topic
from bus.trajectory import TICK_S
from cell import client
from cell.build import running_cell
from cell.daemon.daemon import Daemon
from config.load import load_station
from config.schema import Station

TRIGGERS = ("stop", "hold", "abort", "lease_lost")
FROZEN = "node_frozen"
REST_RAD_S = 0.02
MOVING_RAD_S = 0.3
_SAME_RAD = 1e-9
_RECENT_NS = 2e8
"""States older than this tell nothing of a simulator that has fallen behind meanwhile."""
_SOON_TICKS, _SLOWER = 20, 0.99
_PATIENCE_S = 60.0
_AFTER_S = 2.0
"""How long the arm of a node that goes on is looked at."""

PICKER = """
import sys
from cell import client
from config.load import load_station
with client.connect(load_station(None, sys.argv[1:])) as cell:
    cell.command("pick")
    sys.stdin.read()
"""


class Measured(NamedTuple):
    """Until the brake begins, or the freeze is noticed; and from the trigger, or the thaw, until the arm rests."""

    first_ms: float
    rest_s: float


class Moment(NamedTuple):
    """The arm as it was published."""

    stamp_ns: int
    q_rad: np.ndarray
    dq_rad_s: np.ndarray


@dataclass
class Witness:
    """The notes about one pick: the plan, what was executed, the arm's states, and whether it is over."""

    plan: PickPlan | None = None
    execution: Execution | None = None
    result: CycleResult | None = None
    states: list[Moment] = field(default_factory=list)

    def observe(self, _topic: Topic, message: Message | bytes) -> None:
        if isinstance(message, StageRecord):
            if isinstance(message.result, PickPlan):
                self.plan = message.result
            elif isinstance(message.result, Execution):
                self.execution = message.result
        elif isinstance(message, CycleResult):
            self.result = message

    def hear(self, heard: Sample) -> None:
        said = JointStates.FromString(heard.payload)
        q_rad, dq_rad_s = (np.array([getattr(one, name) for one in said.joints]) for name in ("position", "velocity"))
        self.states.append(Moment(said.timestamp.ToNanoseconds(), q_rad, dq_rad_s))

    def forget(self) -> None:
        self.plan = self.execution = self.result = None
        self.states = []

    def speed_rad_s(self) -> float:
        return float(np.abs(self.states[-1].dq_rad_s).max()) if self.states else 0.0

    def rest_ns(self, since_ns: int) -> int | None:
        """Of the first state since then from which on no joint moves; None when one still does."""
        after = [state for state in self.states if state.stamp_ns >= since_ns]
        moving = [index for index, state in enumerate(after) if np.abs(state.dq_rad_s).max() > REST_RAD_S]
        resting = after[moving[-1] + 1 :] if moving else after
        return resting[0].stamp_ns if resting else None


def run(
    repeats: int, seed: int, endpoint: str, tell: Callable[[str], None], triggers: tuple[str, ...] = (*TRIGGERS, FROZEN)
) -> dict[str, Any]:
    """``repeats`` picks at real-time pace for every trigger, each interrupted at a random moment of its motion."""
    with TemporaryDirectory() as folder:
        overrides = [f"bus.endpoint={endpoint}", f"recording.folder={folder}", "sim.pace=1", "bus.ask_timeout_s=20"]
        station, witness = load_station(None, overrides), Witness()
        with running_cell(station, witness.observe) as daemon, Bus.join(station.cell_id, endpoint) as ear:
            ear.subscribe(topics.ARM_STATE.key, witness.hear)
            bench = Bench(daemon, station, overrides, witness, np.random.default_rng(seed))
            figures: dict[str, Any] = {}
            for trigger in triggers:
                once, first = (bench.frozen, "noticed_ms") if trigger == FROZEN else (bench.interrupted, "brake_ms")
                figures[trigger] = _summary(bench.measure(trigger, once, repeats, tell), first)
    return figures


@dataclass(frozen=True)
class Bench:
    """A running cell, and what interrupts its picks."""

    daemon: Daemon
    station: Station
    overrides: list[str]
    witness: Witness
    rng: np.random.Generator

    def measure(
        self, trigger: str, once: Callable[[str], Measured | None], repeats: int, tell: Callable[[str], None]
    ) -> list[Measured]:
        """``repeats`` figures; a pick whose motion was just over gives none, and is tried again."""
        figures: list[Measured] = []
        tries = iter(range(3 * repeats + 3))
        while len(figures) < repeats:
            assert next(tries, None) is not None, f"{trigger}: too many picks ended before they could be interrupted"
            self.witness.forget()
            if (measured := once(trigger)) is not None:
                figures.append(measured)
                tell(f"{trigger} {len(figures)}/{repeats}: {measured.first_ms:.1f} ms, {measured.rest_s:.3f} s")
        return figures

    def interrupted(self, trigger: str) -> Measured | None:
        """One pick that a command, or the loss of its lease, interrupts."""
        with self._moving_pick() as picker:
            if self.witness.result is not None:
                return None
            if trigger == "lease_lost":
                started_ns = time.time_ns()
                picker.kill()
            else:
                started_ns = self.send(trigger)
            self._wait_for("Held", "Stopped", "Aborted", "Complete")
            rest_ns = self.witness.rest_ns(started_ns)
            if self.daemon.machine.state == "Held":
                with client.connect(self.station) as cell:
                    cell.command("stop")
            wait(lambda: self.witness.result is not None)
        assert self.witness.result is not None
        assert not (why := trouble(Path(self.witness.result.recording))), why
        brake_ns = _brake_ns(self.witness, started_ns)
        if brake_ns is None or rest_ns is None:
            return None
        return Measured((brake_ns - started_ns) / 1e6, (rest_ns - started_ns) / 1e9)

    def send(self, verb: str) -> int:
        """Send a command; return when [ns UTC]."""
        with client.connect(self.station) as cell:
            started_ns = time.time_ns()
            cell.command(verb)
        return started_ns

    def frozen(self, _trigger: str) -> Measured | None:
        """One pick whose node stands still, and goes on once the cell has noticed."""
        with self._moving_pick():
            if self.witness.result is not None:
                return None
            said = self.daemon.health().nodes["sim"].said
            assert said is not None
            frozen_ns = time.time_ns()
            os.kill(said.pid, signal.SIGSTOP)
            try:
                self._wait_for("Aborting", "Aborted", "Complete")
            finally:
                noticed_ns = time.time_ns()
                os.kill(said.pid, signal.SIGCONT)
            self._wait_for("Aborted", "Complete")
            time.sleep(_AFTER_S)
        rest_ns = self.witness.rest_ns(noticed_ns)
        if rest_ns is None or self.daemon.machine.state == "Complete":
            return None
        return Measured((noticed_ns - frozen_ns) / 1e6, (rest_ns - noticed_ns) / 1e9)

    @contextmanager
    def _moving_pick(self) -> Iterator[subprocess.Popen[bytes]]:
        """The process that holds the lease of a pick whose arm has been moving for a random while."""
        with client.connect(self.station) as cell:
            make_idle(cell)
        command = [sys.executable, "-c", PICKER, *self.overrides]
        picker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
        try:
            self._wait_for("Execute", period_s=0.002)
            wait(lambda: self.witness.speed_rad_s() > MOVING_RAD_S or self.witness.result is not None, period_s=0.002)
            time.sleep(float(self.rng.uniform(0.0, 0.4)))
            yield picker
        finally:
            picker.kill()
            picker.communicate()

    def _wait_for(self, *states: str, period_s: float = 0.005) -> None:
        wait(lambda: self.daemon.machine.state in states, period_s)


def make_idle(cell: client.Client) -> None:
    """From wherever the last pick ended; the lease is given back when ``cell`` closes."""
    state = cell.wait_for_state({"Stopped", "Aborted", "Complete", "Idle"}, _PATIENCE_S).state
    if state == "Aborted":
        cell.command("clear")
        cell.wait_for_state({"Stopped"}, _PATIENCE_S)
    if state != "Idle":
        cell.command("reset")
        cell.wait_for_state({"Idle"}, _PATIENCE_S)


def _brake_ns(witness: Witness, triggered_ns: int) -> int | None:
    """UTC of the first tick that departs from the plan; None when none does, or it could not tell."""
    if witness.plan is None or witness.execution is None:
        return None
    run = witness.execution.runs[-1]
    segment = next((part for part in witness.plan.segments if part.name == run.name), None)
    if segment is None:
        return None
    planned, commanded = segment.trajectory.filtered(), run.motion.commanded_q_rad
    n = min(len(planned), len(commanded))
    departs = np.flatnonzero(np.abs(planned[:n] - commanded[:n]).max(axis=1) > _SAME_RAD)
    if len(departs) == 0:
        return None
    tick = int(departs[0])
    since_ns = triggered_ns - min(tick * 1e6, _RECENT_NS)
    during = [one for one in witness.states if since_ns < one.stamp_ns < triggered_ns]
    zero_ns = _tick_zero_ns(during, run.motion.t_s, run.motion.q_rad, tick * TICK_S)
    if zero_ns is None or _slows(planned, round((triggered_ns - zero_ns) / 1e6)):
        return None
    return zero_ns + round(tick * 1e6)


def _slows(planned: np.ndarray, tick: int) -> bool:
    """Whether the fastest joint of planned commands (n, 7) is slower soon after ``tick`` than it is then."""
    speed_rad = np.abs(np.diff(planned, axis=0)).max(axis=1)
    now, soon = np.clip([tick, tick + _SOON_TICKS], 0, len(speed_rad) - 1)
    return bool(speed_rad[soon] < speed_rad[now] * _SLOWER)


def _tick_zero_ns(states: list[Moment], t_s: np.ndarray, q_rad: np.ndarray, until_s: float) -> int | None:
    """UTC of a motion's first tick: the earliest that its samples before ``until_s``, found in ``states``, allow."""
    before = t_s < until_s
    joint = int(np.argmax(np.ptp(q_rad[before], axis=0)))
    moved = q_rad[before, joint]
    sign = np.sign(moved[-1] - moved[0])
    inside = (np.diff(sign * moved) > 1e-5).nonzero()[0]  # where the position tells the time
    low, high = sign * moved[inside[0]], sign * moved[inside[-1] + 1]
    zeros = [
        state.stamp_ns - round(1e9 * float(np.interp(sign * state.q_rad[joint], sign * moved, t_s[before])))
        for state in states
        if low < sign * state.q_rad[joint] < high
    ]
    return min(zeros, default=None)


def _summary(measured: list[Measured], first: str) -> dict[str, Any]:
    first_ms, rest_s = (np.array(column) for column in zip(*measured, strict=True))
    return {
        first: {"median": round(float(np.median(first_ms)), 1), "p99": round(float(np.quantile(first_ms, 0.99)), 1)},
        "rest_s": {"median": round(float(np.median(rest_s)), 3), "max": round(float(rest_s.max()), 3)},
        "n": len(measured),
    }


def wait(condition: Callable[[], bool], period_s: float = 0.02, patience_s: float = _PATIENCE_S) -> None:
    """Until it is so, or for as long as it may take."""
    give_up_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < give_up_s, "the cell did not get there"
        time.sleep(period_s)
