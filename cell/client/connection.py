"""A connection to a running cell: commands with a lease of its own, and waits for what comes of them."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from bus import topics
from bus.codec import decode
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest, ResultRequest
from bus.errors import BadPayload, NoReply, Refused, ReplyTimeout
from bus.messages import CycleResult, Job
from bus.sample import Sample
from bus.session import Bus
from bus.topics import Topic
from cell.client.inbox import Inbox
from cell.client.lease import HeldLease
from cell.client.names import client_name
from cell.client.questions import Questions
from cell.machine.leases import NEEDS_LEASE, NEEDS_TOKEN
from cell.outcome import Outcome
from config.clock import clock_of
from config.schema import Station


class Client(Questions):
    """One connection to one cell; use `connect`. Only messages of the cell's own session are accepted.

    With its first motion command it takes the lease, and holds it until it closes or gives it back (`release`).

    Args:
        ask_timeout_s: longest wait for a reply.
        also: topics to subscribe to besides states and results.
        client_id: of `client_name`.

    Attributes:
        client_id: its unique name.
    """

    def __init__(self, bus: Bus, ask_timeout_s: float, also: tuple[Topic, ...] = (), client_id: str = "") -> None:
        super().__init__(bus, ask_timeout_s)
        self._now_s = bus.clock.now_s
        self.client_id = client_id or client_name("cell")
        self._lease = HeldLease(bus, self.client_id)
        self._inbox = Inbox(bus, also)

    @property
    def is_gone(self) -> bool:
        """Whether the cell has ended, or the link to it."""
        return self._inbox.is_gone

    def state(self) -> CellState:
        """Return the machine's state now. Raises: CellUnreachable, at once of a cell that is gone; BusError."""
        self._inbox.require_there()
        return super().state()

    def health(self) -> CellHealth:
        """Return the cell's health now, node by node. Raises: as `state`."""
        self._inbox.require_there()
        return super().health()

    def command(
        self,
        verb: str,
        *,
        cycles: int = 1,
        until_empty: bool = False,
        object_name: str | None = None,
        job: Job | None = None,
    ) -> CommandReply:
        """Send one command.

        Args:
            cycles, until_empty: the picks of a ``start``. ``object_name``: of the simulated object to present.
            job: what each pick is asked for; of ``cancel``, its ``job_id`` alone counts.

        Raises: Refused with code, reason and the available commands; NoReply without a cell.
        """
        request = CommandRequest(cycles=cycles, until_empty=until_empty, object=object_name, job=job or Job())
        return self.send(verb, request)

    def send(self, verb: str, request: CommandRequest) -> CommandReply:
        """Send one command as it is, with a new ``command_id`` where it has none.

        Args:
            request: its ``client_id`` counts for commands that need no lease; otherwise it is this client's.

        Raises: as `command`.
        """
        needs_lease = verb in NEEDS_LEASE | NEEDS_TOKEN
        if needs_lease:
            self._lease.take()
        named = {
            "command_id": request.command_id or uuid.uuid4().hex,
            "client_id": self.client_id if needs_lease else request.client_id or self.client_id,
        }
        request = request.model_copy(update=named)
        with suppress(NoReply):
            return self._ask(verb, request)
        self.state()  # a cell that answers this would answer any command that reached it
        try:
            return self._ask(verb, request)  # a cell that has just begun; the same id acts once
        except NoReply as error:
            raise Refused(
                f"The cell is there, but {verb!r} does not reach it: this certificate may look, and stop it, no more.",
                "Use that of an operator (bus.zenoh); the roles: docs/security.md.",
                code="NO_RIGHT",
            ) from error

    def _ask(self, verb: str, request: CommandRequest) -> CommandReply:
        try:
            return self._bus.request(topics.COMMAND, request, CommandReply, timeout_s=self._timeout_s, verb=verb)
        except ReplyTimeout:
            self._inbox.require_there()  # it is tried all the same: it may be a stop
            raise

    def release(self) -> None:
        """Give the lease back: other clients may command; motion that continues is held. Idempotent."""
        self._lease.give_back()

    def end_heartbeat(self) -> None:
        """Say no more that this client runs; needed before its process ends."""
        self._lease.end_heartbeat()

    def wait_for_state(self, wanted: set[str], timeout_s: float) -> CellState:
        """Return the first state, from now on, that is in ``wanted``, within ``timeout_s``.

        Raises: ReplyTimeout, CellUnreachable.
        """
        give_up_s = self._now_s() + timeout_s
        while (state := self.state()).state not in wanted:
            if self._now_s() > give_up_s:
                raise self._late(f"The cell is still {state.state} after {timeout_s:.0f} s.")
            self._inbox.next_of((topics.STATE,), give_up_s)
        return state

    def wait_for_result(self, cycle_id: str, timeout_s: float) -> CycleResult:
        """Return the result of the pick that began as ``cycle_id``, of its last attempt, within ``timeout_s``.

        Messages only wake the wait; the result itself is requested from the cell.

        Raises: ReplyTimeout, CellUnreachable.
        """
        give_up_s = self._now_s() + timeout_s
        outcome = Outcome(self, cycle_id)
        while (result := outcome.ask()) is None:
            if self._now_s() > give_up_s:
                raise self._late(f"Cycle {outcome.cycle_id} gave no result within {timeout_s:.0f} s.")
            self._inbox.next_of((topics.RESULT,), give_up_s)
        return result

    def result(self, cycle_id: str) -> CycleResult | None:
        """Return the cell's result of a cycle; None while it has none. Raises: BusError."""
        request = ResultRequest(cycle_id=cycle_id)
        try:
            return self._bus.request(topics.RESULT_NOW, request, CycleResult, timeout_s=self._timeout_s)
        except Refused as refusal:
            if refusal.code != "NO_RESULT":
                raise
            return None
        except NoReply:
            self._inbox.require_there()
            raise

    def next_said(self, timeout_s: float) -> CellState | CycleResult:
        """Return the next state or result within ``timeout_s``; undecodable ones are skipped.

        Raises: ReplyTimeout, CellUnreachable.
        """
        give_up_s = self._now_s() + timeout_s
        while self._now_s() < give_up_s:
            sample = self._inbox.next_of((topics.STATE, topics.RESULT), give_up_s)
            with suppress(BadPayload):
                if sample is not None and sample.key == topics.STATE.key:
                    return decode(CellState, sample.payload)
                if sample is not None:
                    return decode(CycleResult, sample.payload)
        raise self._late(f"The cell has said nothing for {timeout_s:.0f} s.")

    def heard(self) -> Iterator[Sample]:
        """Yield the samples received since the last call, oldest first; does not wait."""
        return self._inbox.drain()

    def next_heard(self, timeout_s: float) -> Sample | None:
        """Return the next sample of any topic; None after ``timeout_s`` without one, or when the cell is gone."""
        return self._inbox.next(timeout_s)

    def _late(self, text: str) -> ReplyTimeout:
        """Return the error of a wait that is over; it says when the machine is too busy."""
        return ReplyTimeout(f"{text}{self._bus.clock.busy_note()}", "See `cell status`.")


@contextmanager
def connect(station: Station, also: tuple[Topic, ...] = (), *, client_id: str = "") -> Iterator[Client]:
    """A client of the station's running cell; ``client_id``: of `client_name`.

    Raises: CellUnreachable; ConfigError for an unsafe connection.
    """
    clock = clock_of(station)
    with Bus.join(station.cell_id, station.bus.endpoint, security=station.bus.zenoh, clock=clock) as bus:
        client = Client(bus, station.bus.ask_timeout_s, also, client_id)
        try:
            yield client
        finally:
            client.end_heartbeat()
