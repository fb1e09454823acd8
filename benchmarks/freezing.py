"""Time until the arm rests when the commander of its motion is frozen (SIGSTOP) during a real pick.

The frozen process is the daemon (``cell start``, a process of its own), or the client that holds the lease: a plain
Zenoh program with Zenoh's own transport lease of 10 s and a heartbeat every 0.2 s (docs/states.md). Rest: the first
state of the arm, measured and stamped by its node, after which no joint is faster than `REST_RAD_S`. A frozen daemon
receives and forwards nothing, so these states come over a pipe of the node (`benchmarks.traced`). An arm that rests at
the planned end of its motion does not show a brake: such a pick is repeated.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from benchmarks.started import cell_started
from benchmarks.stopping import MOVING_RAD_S, PICKER, Witness, make_idle, wait
from benchmarks.traced import node_traced
from bus.errors import BusError
from bus.messages import PickPlan
from cell import client
from config.load import load_station
from config.schema import Station
from logs.mcap.reader import read_cycle

TRIGGERS = ("daemon_frozen", "client_frozen")
_NODE = "sim"
_FROZEN_S = 2.5
_LONGEST_S = 15.0
"""Who rests later than that does not rest."""
_PATIENCE_S = 60.0
_AT_END_RAD = 2e-3
_SETTLED = {"Held", "Stopped", "Aborted", "Complete"}

PLAIN = """
import json, sys, threading, time, zenoh
endpoint, cell = sys.argv[1], f"cell/{sys.argv[2]}"
config = zenoh.Config.from_json5(json.dumps(
    {"mode": "client", "connect": {"endpoints": [endpoint]}, "scouting": {"multicast": {"enabled": False}}}))
session = zenoh.open(config)
token = session.liveliness().declare_token(f"{cell}/lease/plain")
def beat():
    while True:
        session.put(f"{cell}/lease/plain", "{}")
        time.sleep(0.2)
threading.Thread(target=beat, daemon=True).start()
for reply in session.get(f"{cell}/command/pick", payload='{"client_id": "plain"}', timeout=20):
    print(reply.ok is not None or reply.err.payload.to_string(), file=sys.stderr if reply.ok is None else sys.stdout)
sys.stdin.read()
"""


class Rested(NamedTuple):
    """The rest of the arm after the freeze: when, and where."""

    rest_s: float
    q_rad: np.ndarray


def run(
    repeats: int, seed: int, endpoint: str, tell: Callable[[str], None], triggers: tuple[str, ...] = TRIGGERS
) -> dict[str, Any]:
    """``repeats`` picks at real-time pace for every trigger, each frozen at a random moment of its motion."""
    figures: dict[str, Any] = {}
    with TemporaryDirectory() as folder:
        overrides = [f"bus.endpoint={endpoint}", f"recording.folder={folder}", "sim.pace=1",
                     f"nodes.{_NODE}.run=elsewhere"]  # fmt: skip
        witness = Witness()
        with cell_started(overrides) as daemon, node_traced(_NODE, overrides, witness.states.append):
            bench = _Bench(daemon.pid, load_station(None, overrides), overrides, witness, np.random.default_rng(seed))
            for trigger in triggers:
                figures[trigger] = _summary(bench.measure(trigger, repeats, tell))
    return figures


@dataclass(frozen=True)
class _Bench:
    """A cell in processes of its own, and what freezes them."""

    daemon_pid: int
    station: Station
    overrides: list[str]
    witness: Witness
    rng: np.random.Generator

    def measure(self, trigger: str, repeats: int, tell: Callable[[str], None]) -> list[float]:
        """``repeats`` times until rest [s]."""
        once = self._daemon_frozen if trigger == TRIGGERS[0] else self._client_frozen
        rests_s: list[float] = []
        tries = iter(range(4 * repeats + 4))
        while len(rests_s) < repeats:
            assert next(tries, None) is not None, f"{trigger}: too many picks ended before they could be frozen"
            rested = once()
            if rested is None or self._is_by_plan(rested):
                continue
            rests_s.append(rested.rest_s)
            tell(f"{trigger} {len(rests_s)}/{repeats}: {rested.rest_s:.3f} s, then {self._how_it_ended()}")
        return rests_s

    def _daemon_frozen(self) -> Rested | None:
        with self._moving_pick([sys.executable, "-c", PICKER, *self.overrides]):
            frozen_ns = time.time_ns()
            os.kill(self.daemon_pid, signal.SIGSTOP)
            try:
                time.sleep(_FROZEN_S)
            finally:
                os.kill(self.daemon_pid, signal.SIGCONT)
            return self._rest(frozen_ns)

    def _client_frozen(self) -> Rested | None:
        command = [sys.executable, "-c", PLAIN, self.station.bus.endpoint, self.station.cell_id]
        with self._moving_pick(command) as holder, client.connect(self.station) as operator:
            frozen_ns = time.time_ns()
            holder.send_signal(signal.SIGSTOP)
            try:
                operator.wait_for_state(_SETTLED, _PATIENCE_S)
                rested = self._rest(frozen_ns)
            finally:
                holder.send_signal(signal.SIGCONT)
            if operator.state().state == "Held":
                operator.command("stop")
            return rested

    @contextmanager
    def _moving_pick(self, command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
        """The process ``command``, which picks, once its arm has been moving for a random while."""
        with client.connect(self.station) as operator:
            make_idle(operator)
        self.witness.states.clear()
        holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            wait(lambda: self.witness.speed_rad_s() > MOVING_RAD_S, period_s=0.002)
            time.sleep(float(self.rng.uniform(0.0, 0.4)))
            yield holder
        finally:
            holder.kill()
            holder.communicate()

    def _rest(self, frozen_ns: int) -> Rested | None:
        """None when it rested already."""
        states = self.witness.states
        if self.witness.speed_rad_s() > MOVING_RAD_S:
            wait(lambda: self.witness.speed_rad_s() < 0.02, patience_s=_LONGEST_S)
        time.sleep(0.5)
        rest_ns = self.witness.rest_ns(frozen_ns)
        assert rest_ns is not None, f"the arm does not rest within {_LONGEST_S} s"
        q_rad = next(state.q_rad for state in states if state.stamp_ns >= rest_ns)
        return Rested((rest_ns - frozen_ns) / 1e9, q_rad) if rest_ns > frozen_ns + 50_000_000 else None

    def _is_by_plan(self, rested: Rested) -> bool:
        """Whether it rests where a segment of the newest recording's plan ends."""
        plan = read_cycle(self._newest()).stages["plan"].result
        assert isinstance(plan, PickPlan)
        ends = [segment.trajectory.end_q_rad for segment in plan.segments]
        return any(float(np.abs(rested.q_rad - end).max()) < _AT_END_RAD for end in ends)

    def _newest(self) -> Path:
        """The recording of the pick that was frozen, once the cell has settled."""
        give_up_s = time.monotonic() + _PATIENCE_S
        while True:
            try:
                with client.connect(self.station) as operator:
                    operator.wait_for_state({"Stopped", "Aborted", "Complete"}, _PATIENCE_S)
                return max(self.station.recording.folder.rglob("*.mcap"))
            except BusError:  # it has just been thawed
                assert time.monotonic() < give_up_s
                time.sleep(0.1)

    def _how_it_ended(self) -> str:
        result = read_cycle(self._newest()).result
        return "no result" if result is None else f"{result.result} {result.code or ''}: {result.reason}"


def _summary(rests_s: list[float]) -> dict[str, Any]:
    rest_s = {"median": round(float(np.median(rests_s)), 3), "max": round(max(rests_s), 3)}
    return {"rest_s": rest_s, "n": len(rests_s)}
