"""Monitors the nodes: their liveliness tokens (dead, killed) and their streams (frozen).

A stream counts as alive only while its messages are decodable and new. In a simulation, where token and streams have
more time, the state of a node's process shows that a signal has halted it.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path

from bus import topics
from bus.clock import WALL_CLOCK, DeadlineClock
from bus.codec import decode
from bus.codes import Code
from bus.commands import CellHealth, Health, NodeHealth
from bus.errors import BadPayload, CycleFailure
from bus.messages import HandState
from bus.sample import Sample
from bus.secured import LEASE_MS
from bus.sensor_codec import arm_stamp_ns
from bus.session import Bus
from config.schema import Station

_log = logging.getLogger(__name__)
LOOK_PERIOD_S = 0.05
_YOUNG_S = 3.0
"""Time until a node's loops have run long enough to know their rates."""
_LATE_S = 2 * LOOK_PERIOD_S
"""A look later than this: this process was suspended, and has not yet received the messages of that time."""
_SLOW = 0.6
"""A loop below this share of its rate answers everything, but is broken."""

_HALTED_S = LEASE_MS / 1000
"""Longest halt of a node's process [wall s]: with deadlines in wall time its token would go then."""
_UNREADABLE, _REPEATED = "unreadable", "repeated"


def is_halted(pid: int) -> bool:
    """True when a signal (SIGSTOP, a debugger) has halted a process of this machine."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "Tt"
    except (OSError, IndexError):  # the process is gone, or the system is not Linux
        return False


class NodeMonitor:
    """The node monitor: the known state of every node. All members may be called from any thread; none blocks.

    Args:
        on_lost: called with (node, failure) once when a node is lost: its token is gone, or a stream of it is silent.
        restarts: gives the number of restarts of a node.
        clock: the clock of all silence.
        is_halted: tells whether a signal has halted a process of this machine.
    """

    def __init__(
        self,
        station: Station,
        on_lost: Callable[[str, CycleFailure], None],
        restarts: Callable[[str], int],
        clock: DeadlineClock = WALL_CLOCK,
        is_halted: Callable[[int], bool] = is_halted,
    ) -> None:
        self._clock, self._is_halted = clock, is_halted
        self._nodes = station.nodes
        self._stale_s, self._frozen_s = station.bus.stale_s, station.bus.frozen_s
        self._known = {key for name in station.nodes for key in self._streams(name)}
        self._on_lost, self._restarts = on_lost, restarts
        self._changing = threading.Lock()
        self._alive: set[str] = set()
        self._gone_since_s: dict[str, float] = {}
        self._heard_s: dict[str, float] = {}  # by the clock, by key, of the streams of living nodes
        self._stamps_ns: dict[str, int] = {}  # of the newest state received there
        self._useless: dict[str, str] = {}  # the error of messages received there instead
        self._said: dict[str, Health] = {}
        self._silent: set[str] = set()
        self._halted_since_s: dict[str, float] = {}  # wall time; inf once it was reported
        self._looked_s = self._clock.now_s()

    def listen(self, bus: Bus) -> None:
        """Subscribe to tokens; samples of streams go to `hear` once `cell.nodes.speakers` has identified their node."""
        bus.watch_alive(topics.NODE_ALIVE, self.change)

    def change(self, name: str, is_alive: bool) -> None:
        """Process the arrival or the end of a node's token."""
        if name not in self._nodes:
            return
        with self._changing:
            for key in self._streams(name):
                for known in (self._heard_s, self._stamps_ns, self._useless):
                    known.pop(key, None)
                self._silent.discard(key)
                if is_alive:
                    self._heard_s[key] = self._clock.now_s()
            if is_alive:
                self._alive.add(name)
                self._gone_since_s.pop(name, None)
                self._said.pop(name, None)  # health of an earlier process
            else:
                self._alive.discard(name)
                self._gone_since_s.setdefault(name, self._clock.now_s())
        if not is_alive:
            self._on_lost(name, CycleFailure(Code.NODE_LOST, f"The node {name!r} is gone.{self._clock.busy_note()}"))

    def hear(self, sample: Sample) -> None:
        """Process a sample of a stream; it counts when it is decodable and differs from the last one."""
        if sample.key not in self._known:  # not of a node
            return
        try:
            stamp_ns = self._read(sample)
        except BadPayload as error:
            stamp_ns = None
            if sample.key not in self._useless:  # log once, not a hundred times a second
                _log.warning("%s: %s", sample.key, error)
        with self._changing:
            if stamp_ns is None:
                self._useless[sample.key] = _UNREADABLE
            elif stamp_ns == self._stamps_ns.get(sample.key):
                self._useless[sample.key] = _REPEATED
            else:
                self._stamps_ns[sample.key] = stamp_ns
                self._heard_s[sample.key] = self._clock.now_s()
                self._useless.pop(sample.key, None)
                self._silent.discard(sample.key)

    def _read(self, sample: Sample) -> int:
        """The stamp of a state; the arrival time of a node's health, which is kept. Raises: BadPayload."""
        if sample.key == topics.ARM_STATE.key:
            return arm_stamp_ns(sample.payload)
        if sample.key == topics.HAND_STATE.key:
            return decode(HandState, sample.payload).stamp_ns
        self._said[sample.key.split("/")[1]] = decode(Health, sample.payload)
        return time.monotonic_ns()

    def look(self) -> None:
        """Report every stream that has just fallen silent; time in which this process was suspended does not count."""
        if self._clock.is_slowed:
            self._look_for_halted()
        now_s = self._clock.now_s()
        self._forgive(now_s)
        for name in self._nodes:
            for key, limit_s in self._streams(name).items():
                with self._changing:
                    age_s = now_s - self._heard_s.get(key, now_s)
                    is_new = age_s > limit_s and key not in self._silent
                    if is_new:
                        self._silent.add(key)
                if is_new:
                    self._on_lost(name, self._loss(name, key, age_s))

    def _look_for_halted(self) -> None:
        """Report every node whose process has just been halted for too long."""
        now_s = time.monotonic()
        for name, said in list(self._said.items()):
            if name not in self._alive or not self._is_halted(said.pid):
                self._halted_since_s.pop(name, None)
            elif now_s - self._halted_since_s.setdefault(name, now_s) > _HALTED_S:
                self._halted_since_s[name] = math.inf
                text = f"The node {name!r} hangs: its process {said.pid} has been halted by a signal."
                self._on_lost(name, CycleFailure(Code.NODE_LOST, text))

    def _loss(self, name: str, key: str, age_s: float) -> CycleFailure:
        """The failure for a silent stream: its device, when the node reports it or repeats itself; else the node."""
        useless, said = self._useless.get(key), self._said.get(name)
        loop = said.loops.get(key.replace("/", ".")) if said is not None else None
        if loop is not None and loop.fault:
            return CycleFailure(Code.DEVICE_LOST, f"The node {name!r} cannot say {key!r}: {loop.fault}")
        if useless == _REPEATED:
            device = key.partition("/")[0]
            return CycleFailure(Code.DEVICE_LOST, f"The {device} has been saying the same for {age_s:.1f} s.")
        fault = f"says what cannot be read on {key!r}" if useless else f"hangs: nothing on {key!r} for {age_s:.1f} s"
        return CycleFailure(Code.NODE_LOST, f"The node {name!r} {fault}.{'' if useless else self._starved(said)}")

    def _starved(self, said: Health | None) -> str:
        """A note that this machine is too busy, if it is: a starved node is not at fault; else ""."""
        busy = self._clock.busy_note()
        missed = {name: loop.missed for name, loop in (said.loops if said is not None else {}).items() if loop.missed}
        left_out = "; ".join(f"{name} had left out {count} rounds" for name, count in missed.items())
        return f"{busy.removesuffix('.')}; {left_out}." if busy and left_out else busy

    def _forgive(self, now_s: float) -> None:
        late_s = max(0.0, now_s - self._looked_s - _LATE_S)
        self._looked_s = now_s
        with self._changing:
            for key, heard_s in self._heard_s.items() if late_s > 0.0 else ():
                self._heard_s[key] = min(now_s, heard_s + late_s)

    def unheard_for_s(self, name: str) -> float:
        """Time since the node's token ended, or since its last health message; 0 if it has never been up."""
        with self._changing:
            health_key = topics.NODE_HEALTH.key.format(name=name)
            since_s = self._gone_since_s.get(name, self._heard_s.get(health_key))
        return 0.0 if since_s is None else self._clock.now_s() - since_s

    def health(self) -> CellHealth:
        """Return the cell's health now."""
        nodes = {
            name: NodeHealth(
                is_alive=name in self._alive,
                problems=tuple(self._problems(name)),
                restarts=self._restarts(name),
                said=self._said.get(name),
            )
            for name in self._nodes
        }
        return CellHealth(is_healthy=not any(node.problems for node in nodes.values()), nodes=nodes)

    def _problems(self, name: str) -> list[str]:
        if name not in self._alive:
            return ["not up"]
        with self._changing:
            problems = [f"silent on {key}" for key in self._streams(name) if key in self._silent]
            unreadable = [key for key in self._streams(name) if self._useless.get(key) == _UNREADABLE]
            problems += [f"says what cannot be read on {key}" for key in unreadable]
        said = self._said.get(name)
        for loop, runs in (said.loops if said is not None and said.uptime_s > _YOUNG_S else {}).items():
            if runs.rate_hz < _SLOW * runs.target_hz:
                problems.append(f"{loop} at {runs.rate_hz:.0f} of {runs.target_hz:.0f} Hz")
        return problems

    def _streams(self, name: str) -> dict[str, float]:
        """The streams that the node must publish, and their largest age [s]."""
        serves = self._nodes[name].serves
        streams = {topics.NODE_HEALTH.key.format(name=name): self._frozen_s}
        streams |= {topics.ARM_STATE.key: self._stale_s} if "arm" in serves else {}
        streams |= {topics.HAND_STATE.key: self._stale_s} if "hand" in serves else {}
        return streams
