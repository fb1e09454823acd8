"""Two watchdogs over the nodes: one for tokens that go (dead, killed), one for streams that fall silent (frozen)."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from bus import topics
from bus.codec import decode
from bus.codes import Code
from bus.commands import CellHealth, Health, NodeHealth
from bus.errors import BadPayload, CycleFailure
from bus.session import Bus, Heard
from config.schema import Station

_log = logging.getLogger(__name__)
LOOK_PERIOD_S = 0.05
_HEALTH_MAX_AGE_S = 3.0
_SLOW = 0.6
"""A loop below this share of its rate is alive, answers everything, and is badly broken."""


class Watch:
    """What is known of every node. All members may be called from any thread; none blocks.

    Args:
        on_lost: told (node, failure) once when a node is lost: its token is gone, or a stream of it is silent.
        restarts: how often a node was brought back.
    """

    def __init__(
        self, station: Station, on_lost: Callable[[str, CycleFailure], None], restarts: Callable[[str], int]
    ) -> None:
        self._nodes = station.nodes
        self._stale_s = station.bus.stale_s
        self._on_lost, self._restarts = on_lost, restarts
        self._changing = threading.Lock()
        self._alive: set[str] = set()
        self._gone_since_s: dict[str, float] = {}
        self._heard_s: dict[str, float] = {}  # by key, of the streams of living nodes
        self._said: dict[str, Health] = {}
        self._silent: set[str] = set()
        self._malformed: dict[str, int] = {}

    def listen(self, bus: Bus) -> None:
        """Hear tokens and streams."""
        bus.watch_alive(topics.NODE_ALIVE, self.change)
        for topic in (topics.ARM_STATE, topics.HAND_STATE, topics.NODE_HEALTH):
            bus.subscribe(topic.key.replace("{name}", "*"), self.hear)

    def change(self, name: str, is_alive: bool) -> None:
        """A node's token came or went."""
        if name not in self._nodes:
            return
        with self._changing:
            for key in self._streams(name):
                self._heard_s.pop(key, None)
                self._silent.discard(key)
            if is_alive:
                self._alive.add(name)
                self._gone_since_s.pop(name, None)
            else:
                self._alive.discard(name)
                self._gone_since_s.setdefault(name, time.monotonic())
        if not is_alive:
            self._on_lost(name, CycleFailure(Code.NODE_LOST, f"The node {name!r} is gone."))

    def hear(self, heard: Heard) -> None:
        """A stream said something; a health that is none is no sign of life, and is counted."""
        if heard.key.startswith("node/"):
            name = heard.key.split("/")[1]
            if name not in self._nodes:
                return
            try:
                self._said[name] = decode(Health, heard.payload)
            except BadPayload as error:
                self._malformed[name] = self._malformed.get(name, 0) + 1
                _log.warning("node %s: %s", name, error)
                return
        with self._changing:
            self._heard_s[heard.key] = time.monotonic()
            self._silent.discard(heard.key)

    def look(self) -> None:
        """Tell of every stream that has just fallen silent."""
        now_s = time.monotonic()
        for name in self._nodes:
            for key, limit_s in self._streams(name).items():
                with self._changing:
                    age_s = now_s - self._heard_s.get(key, now_s)
                    is_new = age_s > limit_s and key not in self._silent
                    if is_new:
                        self._silent.add(key)
                if is_new:
                    text = f"The node {name!r} hangs: nothing on {key!r} for {age_s:.1f} s."
                    self._on_lost(name, CycleFailure(Code.NODE_LOST, text))

    def gone_for_s(self, name: str) -> float:
        """How long the node's token has been gone; 0 while it is there, or has never been."""
        since_s = self._gone_since_s.get(name)
        return 0.0 if since_s is None else time.monotonic() - since_s

    def health(self) -> CellHealth:
        """The cell's health now."""
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
        if name in self._malformed:
            problems.append(f"{self._malformed[name]} malformed words about itself")
        said = self._said.get(name)
        for loop, runs in (said.loops if said is not None and said.uptime_s > _HEALTH_MAX_AGE_S else {}).items():
            if runs.rate_hz < _SLOW * runs.target_hz:
                problems.append(f"{loop} at {runs.rate_hz:.0f} of {runs.target_hz:.0f} Hz")
        return problems

    def _streams(self, name: str) -> dict[str, float]:
        """What the node must be heard on, and how old that may get [s]."""
        serves = self._nodes[name].serves
        streams = {topics.NODE_HEALTH.key.format(name=name): _HEALTH_MAX_AGE_S}
        streams |= {topics.ARM_STATE.key: self._stale_s} if "arm" in serves else {}
        streams |= {topics.HAND_STATE.key: self._stale_s} if "hand" in serves else {}
        return streams
