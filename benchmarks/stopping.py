"""How soon the arm brakes, and rests, after a command, an abort or a lost lease - in the middle of a real pick.

Brake: the first control tick (1 kHz) whose command departs from the planned motion. Its wall time comes from the arm's
published states, matched with the motion's own samples: the simulated arm plays ten ticks at a time, so a figure may be
up to 10 ms too long, or its instant that much too early. Rest: the first published state after which no joint is
faster than `REST_RAD_S`.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from bus import topics
from bus.frozen import Message
from bus.messages import CycleResult, Execution, PickPlan, StageRecord
from bus.session import Bus, Heard
from bus.topics import Topic
from bus.trajectory import TICK_S
from cell import client
from cell.build import running_cell
from cell.daemon import Daemon
from config.load import load_station
from config.schema import Station

TRIGGERS = ("stop", "hold", "abort", "lease_lost")
REST_RAD_S = 0.02
_MOVING_RAD_S = 0.3
_SAME_RAD = 1e-9
_PATIENCE_S = 60.0

_PICKER = """
import sys
from cell import client
from config.load import load_station
with client.connect(load_station(None, sys.argv[1:])) as cell:
    cell.command("pick")
    sys.stdin.read()
"""


class Moment(NamedTuple):
    """The arm as it was published."""

    stamp_ns: int
    q_rad: np.ndarray
    dq_rad_s: np.ndarray


@dataclass
class Witness:
    """What was said of one pick: the plan, what was executed, the arm's states, and whether it is over."""

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

    def hear(self, heard: Heard) -> None:
        said = JointStates.FromString(heard.payload)
        q_rad, dq_rad_s = (np.array([getattr(one, name) for one in said.joints]) for name in ("position", "velocity"))
        self.states.append(Moment(said.timestamp.ToNanoseconds(), q_rad, dq_rad_s))

    def forget(self) -> None:
        self.plan = self.execution = self.result = None
        self.states = []

    def speed_rad_s(self) -> float:
        return float(np.abs(self.states[-1].dq_rad_s).max()) if self.states else 0.0


def run(repeats: int, seed: int, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """``repeats`` picks at real-time pace for every trigger, each interrupted at a random moment of its motion."""
    rng = np.random.default_rng(seed)
    figures: dict[str, Any] = {}
    with TemporaryDirectory() as folder:
        overrides = [f"bus.endpoint={endpoint}", f"recording.folder={folder}", "sim.pace=1"]
        station = load_station(None, overrides)
        witness = Witness()

        with running_cell(station, witness.observe) as daemon, Bus.join(station.cell_id, endpoint) as ear:
            ear.subscribe(topics.ARM_STATE.key, witness.hear)
            for trigger in TRIGGERS:
                brake_ms: list[float] = []
                rest_s: list[float] = []
                while len(rest_s) < repeats:
                    witness.forget()
                    measured = _once(trigger, daemon, station, overrides, witness, rng)
                    if measured is not None:
                        brake_ms.append(measured[0])
                        rest_s.append(measured[1])
                        tell(f"{trigger} {len(rest_s)}/{repeats}: {measured[0]:.1f} ms, {measured[1]:.3f} s")
                figures[trigger] = _summary(brake_ms, rest_s)
    return figures


def _once(
    trigger: str,
    daemon: Daemon,
    station: Station,
    overrides: list[str],
    witness: Witness,
    rng: np.random.Generator,
) -> tuple[float, float] | None:
    """(brake [ms], rest [s]) of one pick; None when the motion was just over."""
    with client.connect(station) as cell:
        _make_idle(cell)
    picker = subprocess.Popen(
        [sys.executable, "-c", _PICKER, *overrides], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
    )
    try:
        _wait(lambda: daemon.machine.state == "Execute" and witness.speed_rad_s() > _MOVING_RAD_S, period_s=0.002)
        time.sleep(float(rng.uniform(0.0, 0.4)))
        if trigger == "lease_lost":
            started_ns = time.time_ns()
            picker.send_signal(signal.SIGKILL)
        else:
            with client.connect(station) as cell:
                started_ns = time.time_ns()
                cell.command(trigger)
        _wait(lambda: daemon.machine.state in ("Held", "Stopped", "Aborted", "Complete"))
        rest_ns = next((state.stamp_ns for state in _resting(witness.states, started_ns)), None)
        if daemon.machine.state == "Held":
            with client.connect(station) as cell:
                cell.command("stop")
        _wait(lambda: witness.result is not None)
    finally:
        picker.kill()
        picker.communicate()
    brake_ns = _brake_ns(witness, started_ns)
    if brake_ns is None or rest_ns is None:
        return None
    return (brake_ns - started_ns) / 1e6, (rest_ns - started_ns) / 1e9


def _make_idle(cell: client.Client) -> None:
    """From wherever the last pick ended; the lease is given back when ``cell`` closes."""
    state = cell.wait_for_state({"Stopped", "Aborted", "Complete", "Idle"}, _PATIENCE_S).state
    if state == "Aborted":
        cell.command("clear")
        cell.wait_for_state({"Stopped"}, _PATIENCE_S)
    if state != "Idle":
        cell.command("reset")
        cell.wait_for_state({"Idle"}, _PATIENCE_S)


def _resting(states: list[Moment], since_ns: int) -> list[Moment]:
    """The states since ``since_ns`` from which on no joint moves."""
    after = [state for state in states if state.stamp_ns >= since_ns]
    moving = [index for index, state in enumerate(after) if np.abs(state.dq_rad_s).max() > REST_RAD_S]
    return after[moving[-1] + 1 :] if moving else after


def _brake_ns(witness: Witness, triggered_ns: int) -> int | None:
    """UTC of the first tick that departs from the plan; None when none does."""
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
    during = [one for one in witness.states if triggered_ns - tick * 1e6 < one.stamp_ns < triggered_ns]
    return _tick_zero_ns(during, run.motion.t_s, run.motion.q_rad, tick * TICK_S) + round(tick * 1e6)


def _tick_zero_ns(states: list[Moment], t_s: np.ndarray, q_rad: np.ndarray, until_s: float) -> int:
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
    return min(zeros)


def _summary(brake_ms: list[float], rest_s: list[float]) -> dict[str, Any]:
    return {
        "brake_ms": {
            "median": round(float(np.median(brake_ms)), 1),
            "p99": round(float(np.quantile(brake_ms, 0.99)), 1),
        },
        "rest_s": {"median": round(float(np.median(rest_s)), 3), "max": round(max(rest_s), 3)},
        "n": len(rest_s),
    }


def _wait(condition: Callable[[], bool], period_s: float = 0.02) -> None:
    give_up_s = time.monotonic() + _PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "the cell did not get there"
        time.sleep(period_s)
