"""Talks to a running cell from another process: state, commands, results."""

from __future__ import annotations

import getpass
import itertools
import os
import queue
import re
import socket
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from bus import topics
from bus.codec import decode
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest, Nothing
from bus.errors import BadPayload, CellUnreachable, NoReply, Refused, ReplyTimeout
from bus.faults import Fault, FaultRequest, Part
from bus.heard import Heard
from bus.messages import CycleResult
from bus.session import Bus
from bus.topics import Topic
from cell.leases import CELL_CLIENT, NEEDS_LEASE, NEEDS_TOKEN
from cell.machine import refuse
from config.schema import Station

SETTLED = frozenset({"Stopped", "Idle", "Complete", "Aborted"})
"""States in which nothing moves, and nothing that was commanded goes on by itself."""
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9._-]")
_numbers = itertools.count(1)


class Client:
    """One connection to one cell; use `connect`. ``also``: topics to hear besides states and results.

    With its first command that moves the arm it declares a lease, and keeps it until it closes.

    Attributes:
        client_id: its name; no other connection has it. ``is_gone``: the cell has ended, or the link to it.
    """

    def __init__(self, bus: Bus, ask_timeout_s: float, also: tuple[Topic, ...] = (), client_id: str = "") -> None:
        self._bus = bus
        self._timeout_s = ask_timeout_s
        self.client_id = client_id or client_name("cell")
        self.is_gone = False
        self._has_lease = False
        self._heard: queue.SimpleQueue[Heard | None] = queue.SimpleQueue()  # None: the cell is gone
        for topic in (topics.STATE, topics.RESULT, *also):
            bus.subscribe(topic.key.replace("{name}", "*"), self._heard.put)
        bus.watch_alive(topics.LEASE, self._notice)

    def state(self) -> CellState:
        """The machine's state now."""
        return self._bus.request(topics.STATE_NOW, Nothing(), CellState, timeout_s=self._timeout_s)

    def health(self) -> CellHealth:
        """The cell's health now, node by node."""
        return self._bus.request(topics.HEALTH_NOW, Nothing(), CellHealth, timeout_s=self._timeout_s)

    def command(
        self, verb: str, *, cycles: int = 1, until_empty: bool = False, object_name: str | None = None
    ) -> CommandReply:
        """Send one command. Raises: Refused with code, reason and what is available; NoReply from no cell."""
        if verb in NEEDS_LEASE | NEEDS_TOKEN and not self._has_lease:
            self._bus.announce(topics.LEASE, name=self.client_id)
            self._bus.alive(topics.LEASE)  # answered after the token has arrived
            self._has_lease = True
        request = CommandRequest(
            command_id=uuid.uuid4().hex,
            client_id=self.client_id,
            cycles=cycles,
            until_empty=until_empty,
            object=object_name,
        )
        try:
            reply = self._bus.request(topics.COMMAND, request, CommandReply, timeout_s=self._timeout_s, verb=verb)
        except NoReply as error:
            self.state()  # a cell that answers this answers every command that reaches it
            raise Refused(
                f"The cell is there, but {verb!r} does not reach it: this certificate may look, and stop it, no more.",
                "Use that of an operator (bus.zenoh); the roles: docs/security.md.",
                code="NO_RIGHT",
            ) from error
        refuse(reply)
        return reply

    def fault(self, part: Part, fault: Fault, delay_s: float | None = None) -> None:
        """Tell a part of the cell to misbehave, from now on. Raises: Refused where nobody allows it."""
        request = FaultRequest(fault=fault, delay_s=delay_s)
        try:
            self._bus.ask(topics.FAULT, request, timeout_s=self._timeout_s, part=part)
        except NoReply as error:
            raise Refused(
                f"Nobody lets the {part} be spoiled.",
                "Start the cell with --set faults.allowed=true; a node that is not up cannot be told either.",
                code="FAULTS_NOT_ALLOWED",
            ) from error

    def wait_for_state(self, wanted: set[str], timeout_s: float) -> CellState:
        """The state now, or the next one, that is of ``wanted``. Raises: ReplyTimeout, CellUnreachable."""
        state = self.state()
        give_up_s = time.monotonic() + timeout_s
        while state.state not in wanted:
            heard = self._next(give_up_s, f"The cell is still {state.state} after {timeout_s:.0f} s.")
            if heard.key == topics.STATE.key and (said := decode(CellState, heard.payload)).since_ns > state.since_ns:
                state = said
        return state

    def wait_for_result(self, cycle_id: str, timeout_s: float) -> CycleResult:
        """The result of the pick that began as ``cycle_id``: of its last try. Raises: ReplyTimeout, CellUnreachable."""
        give_up_s = time.monotonic() + timeout_s
        while True:
            result = self._next_result(give_up_s, f"Cycle {cycle_id}", timeout_s)
            if result.cycle_id != cycle_id:
                continue
            if not result.retried_as:
                return result
            cycle_id = result.retried_as

    def next_result(self, timeout_s: float) -> CycleResult:
        """The next result of whichever cycle: of the next one of a ``start``. Raises: ReplyTimeout, CellUnreachable."""
        return self._next_result(time.monotonic() + timeout_s, "The next cycle", timeout_s)

    def next_said(self, timeout_s: float) -> CellState | CycleResult:
        """The next state or result; what cannot be read is none. Raises: ReplyTimeout, CellUnreachable."""
        give_up_s = time.monotonic() + timeout_s
        while True:
            heard = self._next(give_up_s, f"The cell has said nothing for {timeout_s:.0f} s.")
            with suppress(BadPayload):
                if heard.key == topics.STATE.key:
                    return decode(CellState, heard.payload)
                if heard.key == topics.RESULT.key:
                    return decode(CycleResult, heard.payload)

    def heard(self) -> Iterator[Heard]:
        """What was said since the last time, oldest first; does not wait."""
        while not self._heard.empty():
            if (heard := self._heard.get_nowait()) is not None:
                yield heard

    def _next_result(self, give_up_s: float, whose: str, timeout_s: float) -> CycleResult:
        while (heard := self._next(give_up_s, f"{whose} gave no result within {timeout_s:.0f} s.")).key != (
            topics.RESULT.key
        ):
            pass
        return decode(CycleResult, heard.payload)

    def _next(self, give_up_s: float, text: str) -> Heard:
        """Raises: ReplyTimeout; CellUnreachable once the cell is gone."""
        try:
            heard = self._heard.get(timeout=max(0.001, give_up_s - time.monotonic()))
        except queue.Empty:
            raise ReplyTimeout(text, "See `cell status`.") from None
        if heard is None:
            self._heard.put(None)  # for whoever waits next
            raise CellUnreachable("The cell is gone: it ended, or the link to it.", "Start it, then see `cell cycles`.")
        return heard

    def _notice(self, client_id: str, is_alive: bool) -> None:
        if client_id == CELL_CLIENT:
            self.is_gone = not is_alive
            if self.is_gone:
                self._heard.put(None)


@contextmanager
def connect(station: Station, also: tuple[Topic, ...] = (), *, client_id: str = "") -> Iterator[Client]:
    """A client of the station's running cell; ``client_id``: of `client_name`.

    Raises: CellUnreachable; ConfigError for an unsafe way to the cell.
    """
    with Bus.join(station.cell_id, station.bus.endpoint, security=station.bus.zenoh) as bus:
        yield Client(bus, station.bus.ask_timeout_s, also, client_id)


def client_name(what: str) -> str:
    """Who asks, so that another person finds him: program, user, machine and process, ``watch-ann-lab2-4711``.

    Only what a client id may have, at most 100 letters, digits, ``.``, ``_`` and ``-``; no other of this process.
    """
    parts = (what, _user(), socket.gethostname().partition(".")[0])
    name = "-".join(_NOT_IN_A_NAME.sub("_", part)[:24] for part in parts)
    number = next(_numbers)
    return f"{name}-{os.getpid()}" + (f"-{number}" if number > 1 else "")


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a user id without a name, as in containers
        return str(os.getuid())
