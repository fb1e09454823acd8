"""Unauthorised or frozen processes: a second node, a frozen client, a frozen intruder."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import zenoh

from benchmarks.attacked import AS_BENCH, Attacked, wait_until
from benchmarks.freezing import PLAIN
from bus.errors import CellError

_START_S = 40.0
_FROZEN_S = 2.5
_NOTICED_S = 1.5
"""A motion that nobody attends is held in that time."""
_ANSWER_S = 2.0
_MOVING_RAD_S = 0.3
_NODE = "sim"

_ASKS = """
import sys, zenoh
endpoint, what = sys.argv[1:]
config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["' + endpoint + '"]}}')
session = zenoh.open(config)
if what == "asks":
    for _ in range(2000):
        session.get("cell/**", lambda reply: None, timeout=30.0)
else:
    heard = session.declare_subscriber("**", lambda sample: None)
print("ready", flush=True)
sys.stdin.read()
"""


class Peers:
    """Starts them, freezes them, and counts what the cell makes of it."""

    def __init__(self, cell: Attacked, session: zenoh.Session, rng: np.random.Generator) -> None:
        self._cell, self._session, self._rng = cell, session, rng
        self.kinds: dict[str, Callable[[str], None]] = {
            "twin_process": self._twin_process,
            "frozen_client": lambda kind: self._frozen_client(kind, is_kept_alive=False),
            "frozen_client_kept_alive": lambda kind: self._frozen_client(kind, is_kept_alive=True),
            "frozen_asker": lambda kind: self._frozen_intruder(kind, "asks"),
            "frozen_listener": lambda kind: self._frozen_intruder(kind, "hears"),
        }

    def attempt(self, kind: str) -> None:
        """One of them."""
        self.kinds[kind](kind)

    def _twin_process(self, kind: str) -> None:
        """``cell node`` of a name that is served already."""
        cell = self._cell
        options = ["--set", f"bus.endpoint={cell.endpoint}"]
        command = [sys.executable, "-m", "cell", "node", _NODE, *options]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            _, said = process.communicate(timeout=_START_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            cell.tally.accept(kind, "it serves beside the other")
            cell.make_idle()
            return
        refusal = said.strip().splitlines()[-1].partition(":")[0] if said.strip() else f"exit code {process.returncode}"
        cell.tally.by_code[refusal] += 1
        cell.require_idle(kind)

    def _frozen_client(self, kind: str, *, is_kept_alive: bool) -> None:
        """It holds the lease, and is frozen while the arm moves; the intruder may put its heartbeats in its place."""
        cell = self._cell
        command = [sys.executable, "-c", PLAIN, cell.endpoint, cell.station.cell_id]
        with _process(command) as holder:
            is_moving = wait_until(lambda: cell.speed_rad_s() > _MOVING_RAD_S, _START_S)
            if not is_moving:
                cell.tally.crash(f"{kind}: the pick does not begin: {cell.state}, {cell.daemon.publisher.state.reason}")
                cell.make_idle()
                return
            holder.send_signal(signal.SIGSTOP)
            frozen_s = time.monotonic()
            while cell.state == "Execute" and time.monotonic() < frozen_s + _NOTICED_S:
                if is_kept_alive:
                    self._session.put(f"{cell.root}/lease/plain", b"{}")
                time.sleep(0.05)
            if cell.state == "Execute":
                cell.tally.accept(kind, f"the arm goes on for more than {_NOTICED_S} s")
            else:
                cell.tally.by_code["LEASE_LOST"] += 1
        if cell.state not in ("Idle", "Stopped", "Aborted"):
            cell.daemon.command("stop", AS_BENCH)
        cell.settle()
        cell.make_idle()

    def _frozen_intruder(self, kind: str, what: str) -> None:
        """It holds questions, or a subscription to everything; the cell's client is answered all the same."""
        cell = self._cell
        with _process([sys.executable, "-c", _ASKS, cell.endpoint, what]) as intruder:
            assert intruder.stdout is not None
            intruder.stdout.readline()
            intruder.send_signal(signal.SIGSTOP)
            until_s, worst_s = time.monotonic() + _FROZEN_S, 0.0
            try:
                while time.monotonic() < until_s:
                    asked_s = time.monotonic()
                    cell.victim.state()
                    worst_s = max(worst_s, time.monotonic() - asked_s)
                    time.sleep(0.01)
            except CellError as error:
                cell.tally.crash(f"{kind}: {error}")
            else:
                if worst_s > _ANSWER_S:
                    cell.tally.crash(f"{kind}: the cell answered after {worst_s:.1f} s")
                else:
                    cell.tally.by_code["ANSWERED"] += 1
        cell.require_idle(kind)


@contextmanager
def _process(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Killed in the end, frozen or not."""
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()
