"""A cell with an intruder on its bus: its true state, the state its clients receive, and its recovery to Idle."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import zenoh

from benchmarks.tally import Tally
from bus import topics
from bus.commands import CommandRequest
from bus.errors import BusError, CellError
from bus.messages import CycleResult
from bus.session import Bus
from cell import client
from cell.daemon.daemon import Daemon
from cell.machine.owner import refuse
from cell.machine.states import SETTLED
from config.schema import Station
from drivers.remote import remote_devices

_MOVED_RAD, _MOVED_M = 1e-3, 1e-3
_PATIENCE_S = 90.0
_NEXT_COMMAND = {"Aborted": "clear", "Stopped": "reset", "Complete": "reset", "Held": "stop"}
AS_BENCH = CommandRequest(client_id="bench")


class Attacked:
    """A running cell, and a client that may be lied to.

    Args:
        bus: a session of ours, which reads arm and hand; the cell's own would be answered the same.

    Attributes:
        victim: believes what `cell.client.Client` believes. ``result``: of a pick that nobody disturbed.
        root: of the cell's keys. ``sources``: who speaks: ``cell``, and ``node``.
    """

    def __init__(self, daemon: Daemon, station: Station, bus: Bus, victim: client.Client, tally: Tally) -> None:
        self.daemon, self.station, self.victim, self.tally = daemon, station, victim, tally
        self.root = f"{topics.ROOT}/{station.cell_id}"
        self.sources: dict[str, zenoh.EntityGlobalId] = {}
        self._bus = bus
        self._devices = remote_devices(bus, station)
        self._seen = self._look()
        self.make_idle()
        self.result = self.pick()
        self.make_idle()

    @property
    def state(self) -> str:
        """The state that the cell really is in."""
        return str(self.daemon.machine.state)

    @property
    def endpoint(self) -> str:
        return self.station.bus.endpoint

    def q_rad(self) -> np.ndarray:
        """Return where the arm was last seen."""
        return self._seen[0]

    def look(self) -> bool:
        """Whether arm or hand are elsewhere than when last looked at."""
        before = self._seen
        self._see()
        arm_rad, hand_m = np.abs(before[0] - self._seen[0]).max(), abs(before[1] - self._seen[1])
        has_moved = bool(arm_rad > _MOVED_RAD or hand_m > _MOVED_M)
        self.tally.moved += has_moved
        return has_moved

    def speed_rad_s(self) -> float:
        """Of the fastest joint, now."""
        assert self._devices.arm is not None
        return float(np.abs(self._devices.arm.state().dq_rad_s).max())

    def _see(self) -> None:
        """Keep where they are; a crash when they do not say."""
        try:
            self._seen = self._look()
        except CellError as error:
            self.tally.crash(f"arm and hand cannot be seen: {error}")

    def _look(self) -> tuple[np.ndarray, float]:
        arm, hand = self._devices.arm, self._devices.hand
        assert arm is not None and hand is not None
        return arm.state().q_rad, hand.state().width_m

    # --- as its terminal commands -------------------------------------------------------------------------------------

    def command(self, verb: str) -> None:
        """As its own terminal would."""
        refuse(self.daemon.command(verb, AS_BENCH))

    def pick(self) -> CycleResult:
        """One pick from Idle, and its result as its client is told."""
        reply = self.daemon.command("pick", AS_BENCH)
        refuse(reply)
        return self.victim.wait_for_result(reply.cycle_id, _PATIENCE_S)

    def settle(self) -> str:
        """The state once nothing goes on any more."""
        wait_until(lambda: self.state in SETTLED | {"Held"}, _PATIENCE_S)
        return self.state

    def make_idle(self) -> None:
        """Clear, stop and reset as an operator would; what moves meanwhile is no intruder's."""
        give_up_s = time.monotonic() + _PATIENCE_S
        while not (self.state == self.daemon.publisher.state.state == "Idle"):  # it is so, and was said
            if time.monotonic() > give_up_s:
                self.tally.crash(
                    f"the cell does not become Idle again: {self.state}, {self.daemon.publisher.state.reason}"
                )
                raise BusError("The attacked cell is beyond recovery.")
            verb = _NEXT_COMMAND.get(self.state)
            if verb is not None:
                self.daemon.command(verb, AS_BENCH)
            time.sleep(0.02)
        self._see()

    def require_idle(self, what: str) -> None:
        """After what must not disturb it: a crash when it did."""
        if self.state != "Idle":
            self.tally.crash(f"{what}: {self.state}, {self.daemon.publisher.state.reason}")
            self.make_idle()

    def restarts(self) -> int:
        """Return how often a node was brought back."""
        return sum(node.restarts for node in self.daemon.health().nodes.values())


def wait_until(condition: Callable[[], bool], patience_s: float) -> bool:
    """Whether it came to be so in time."""
    give_up_s = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > give_up_s:
            return False
        time.sleep(0.01)
    return True


def plain_session(endpoint: str, zid: str = "") -> zenoh.Session:
    """As a program has it that knows nothing of ours; ``zid``: the name that it claims."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("connect/timeout_ms", "2000")
    config.insert_json5("connect/exit_on_failure", "true")
    config.insert_json5("scouting/multicast/enabled", "false")
    if zid:
        config.insert_json5("id", f'"{zid}"')
    return zenoh.open(config)
