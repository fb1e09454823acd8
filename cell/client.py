"""The client of a running cell in another process: state, commands, results."""

from __future__ import annotations

import getpass
import itertools
import os
import queue
import re
import socket
import threading
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

from bus import topics
from bus.codec import decode
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest, Heartbeat, Nothing, ResultRequest
from bus.errors import BadPayload, BusError, CellUnreachable, NoReply, Refused, ReplyTimeout
from bus.fault_injection import Fault, FaultRequest, Part
from bus.messages import CycleResult, Job, LivePicture, PictureRequest, PlanView, Proposal
from bus.sample import Sample
from bus.session import Bus
from bus.threads import OwnedThread, Role
from bus.topics import Topic
from cell.machine.leases import CELL_CLIENT, HEARTBEAT_S, NEEDS_LEASE, NEEDS_TOKEN
from cell.machine.states import SETTLED
from cell.outcome import Outcome
from config.clock import clock_of
from config.schema import Station

RUNS_AGAIN = frozenset({"Execute", "Completing", "Complete", "Idle"})
"""States after a held cycle goes on; in the last two it ended shortly after."""
LEADS_TO: Mapping[str, frozenset[str]] = {
    "reset": SETTLED,
    "stop": SETTLED,
    "abort": SETTLED,
    "clear": SETTLED,
    "hold": frozenset({"Held"}),
    "unhold": RUNS_AGAIN,
    "suspend": frozenset({"Suspended"}),
    "unsuspend": RUNS_AGAIN,
}
"""Of each command without arguments, the states that it leads to; a client waits for one of them, or for an end."""
_ASK_AGAIN_S = 0.5
"""Time without a message after which the cell is asked, because a sample may have been lost."""
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9._-]")
_numbers = itertools.count(1)


class Client:
    """One connection to one cell; use `connect`. Only messages of the cell's own session are accepted.

    With its first motion command it declares a lease, and publishes a heartbeat every `HEARTBEAT_S`, until it closes or
    gives the lease back (`release`).

    Args:
        ask_timeout_s: longest wait for a reply.
        also: topics to subscribe to besides states and results.
        client_id: of `client_name`.

    Attributes:
        client_id: its unique name. ``is_gone``: the cell has ended, or the link to it.
    """

    def __init__(self, bus: Bus, ask_timeout_s: float, also: tuple[Topic, ...] = (), client_id: str = "") -> None:
        self._bus = bus
        self._timeout_s, self._now_s = ask_timeout_s, bus.clock.now_s
        self.client_id = client_id or client_name("cell")
        self.is_gone = False
        self._heartbeat: OwnedThread | None = None
        self._given_back = threading.Event()
        self._heard: queue.SimpleQueue[Sample | None] = queue.SimpleQueue()  # None: the cell is gone
        for topic in (topics.STATE, topics.RESULT, *also):
            hear = self._believe if topic.speaker == "cell" else self._heard.put
            bus.subscribe(topic.key.replace("{name}", "*"), hear)
        bus.watch_alive(topics.LEASE, self._notice)

    def _believe(self, sample: Sample) -> None:
        """Keep a message of the cell; messages of other sessions on its keys are dropped."""
        if self._bus.cell in (None, sample.source):
            self._heard.put(sample)

    def state(self) -> CellState:
        """The machine's state now. Raises: BusError."""
        return self._bus.request(topics.STATE_NOW, Nothing(), CellState, timeout_s=self._timeout_s)

    def health(self) -> CellHealth:
        """The cell's health now, node by node. Raises: BusError."""
        return self._bus.request(topics.HEALTH_NOW, Nothing(), CellHealth, timeout_s=self._timeout_s)

    def proposal(self) -> Proposal:
        """The planned motion that waits for an answer. Raises: Refused (NO_PROPOSAL); BusError."""
        return self._bus.request(topics.PROPOSAL_NOW, Nothing(), Proposal, timeout_s=self._timeout_s)

    def plan_view(self) -> PlanView:
        """The last plan, to look at in 3-D. Raises: Refused (NO_PLAN); BusError."""
        return self._bus.request(topics.PLAN_NOW, Nothing(), PlanView, timeout_s=self._timeout_s)

    def picture(self, request: PictureRequest | None = None) -> LivePicture:
        """A picture of now. Raises: Refused (NOT_AT_REST, PICTURE_ELSEWHERE), StaleFrame; BusError."""
        request = request or PictureRequest()
        return self._bus.request(topics.PICTURE_NOW, request, LivePicture, timeout_s=self._timeout_s)

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
            self._attend()
        named = {
            "command_id": request.command_id or uuid.uuid4().hex,
            "client_id": self.client_id if needs_lease else request.client_id or self.client_id,
        }
        request = request.model_copy(update=named)
        try:
            return self._bus.request(topics.COMMAND, request, CommandReply, timeout_s=self._timeout_s, verb=verb)
        except NoReply as error:
            self.state()  # a cell that answers this would answer any command that reached it
            raise Refused(
                f"The cell is there, but {verb!r} does not reach it: this certificate may look, and stop it, no more.",
                "Use that of an operator (bus.zenoh); the roles: docs/security.md.",
                code="NO_RIGHT",
            ) from error

    def _attend(self) -> None:
        """Declare the liveliness token of the lease, and start the heartbeat on its key."""
        if self._heartbeat is not None:
            return
        self._bus.announce(topics.LEASE, name=self.client_id)
        self._bus.alive(topics.LEASE)  # answered only after the token has arrived
        self._given_back.clear()
        self._heartbeat = OwnedThread(Role.LOOP, self._beat, of="lease").start()

    def _beat(self) -> None:
        while not self._given_back.is_set():
            try:
                self._bus.publish(topics.LEASE_HEARTBEAT, Heartbeat(), name=self.client_id)
            except BusError:  # the session is closed, which also ends the token
                return
            self._given_back.wait(HEARTBEAT_S)

    def release(self) -> None:
        """Give the lease back: other clients may command; motion that continues is held. Idempotent."""
        if self.end_heartbeat():
            self._bus.withdraw(topics.LEASE, name=self.client_id)

    def end_heartbeat(self) -> bool:
        """Say no more that this client runs, and return whether it did.

        Its thread must have ended before the process does: one that publishes then takes the process down.
        """
        self._given_back.set()
        heartbeat, self._heartbeat = self._heartbeat, None
        if heartbeat is not None:
            heartbeat.join()
        return heartbeat is not None

    def fault(self, part: Part, fault: Fault, delay_s: float | None = None) -> None:
        """Inject a fault into a part of the cell.

        Args:
            delay_s: lateness of a slow part; None = its default.

        Raises: Refused when fault injection is not allowed.
        """
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
        """The first state, from now on, that is in ``wanted``, within ``timeout_s``.

        Raises: ReplyTimeout, CellUnreachable.
        """
        give_up_s = self._now_s() + timeout_s
        while (state := self.state()).state not in wanted:
            if self._now_s() > give_up_s:
                raise self._late(f"The cell is still {state.state} after {timeout_s:.0f} s.")
            self._await((topics.STATE,), give_up_s)
        return state

    def wait_for_result(self, cycle_id: str, timeout_s: float) -> CycleResult:
        """The result of the pick that began as ``cycle_id``, of its last attempt, within ``timeout_s``.

        Messages only wake the wait; the result itself is requested from the cell.

        Raises: ReplyTimeout, CellUnreachable.
        """
        give_up_s = self._now_s() + timeout_s
        outcome = Outcome(self, cycle_id)
        while (result := outcome.ask()) is None:
            if self._now_s() > give_up_s:
                raise self._late(f"Cycle {outcome.cycle_id} gave no result within {timeout_s:.0f} s.")
            self._await((topics.RESULT,), give_up_s)
        return result

    def result(self, cycle_id: str) -> CycleResult | None:
        """The cell's result of a cycle; None while it has none. Raises: BusError."""
        request = ResultRequest(cycle_id=cycle_id)
        try:
            return self._bus.request(topics.RESULT_NOW, request, CycleResult, timeout_s=self._timeout_s)
        except Refused as refusal:
            if refusal.code != "NO_RESULT":
                raise
            return None
        except NoReply:
            self._require_there()
            raise

    def next_said(self, timeout_s: float) -> CellState | CycleResult:
        """The next state or result within ``timeout_s``; undecodable ones are skipped.

        Raises: ReplyTimeout, CellUnreachable.
        """
        give_up_s = self._now_s() + timeout_s
        while self._now_s() < give_up_s:
            sample = self._await((topics.STATE, topics.RESULT), give_up_s)
            with suppress(BadPayload):
                if sample is not None and sample.key == topics.STATE.key:
                    return decode(CellState, sample.payload)
                if sample is not None:
                    return decode(CycleResult, sample.payload)
        raise self._late(f"The cell has said nothing for {timeout_s:.0f} s.")

    def heard(self) -> Iterator[Sample]:
        """The samples received since the last call, oldest first; does not wait."""
        while not self._heard.empty():
            if (sample := self._heard.get_nowait()) is not None:
                yield sample

    def next_heard(self, timeout_s: float) -> Sample | None:
        """The next sample of any topic; None after ``timeout_s`` without one, or when the cell is gone."""
        with suppress(queue.Empty):
            return self._heard.get(timeout=timeout_s)
        return None

    def _await(self, of: tuple[Topic, ...], give_up_s: float) -> Sample | None:
        """The next sample on one of these topics; None after a short time without one. Raises: CellUnreachable."""
        give_up_s = min(give_up_s, self._now_s() + _ASK_AGAIN_S)
        while (left_s := give_up_s - self._now_s()) > 0:
            try:
                sample = self._heard.get(timeout=left_s)
            except queue.Empty:
                return None
            self._require_there()
            if sample is None:  # the cell was gone and is back
                continue
            if any(sample.key == topic.key for topic in of):
                return sample
        return None

    def _late(self, text: str) -> ReplyTimeout:
        """Return the error of a wait that is over; it says when the machine is too busy."""
        return ReplyTimeout(f"{text}{self._bus.clock.busy_note()}", "See `cell status`.")

    def _require_there(self) -> None:
        """Refuse to wait for a lost cell. Raises: CellUnreachable."""
        if self.is_gone:
            raise CellUnreachable("The cell is gone: it ended, or the link to it.", "Start it, then see `cell cycles`.")

    def _notice(self, client_id: str, is_alive: bool) -> None:
        if client_id == CELL_CLIENT:
            self.is_gone = not is_alive
            if self.is_gone:
                self._heard.put(None)


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


def client_name(what: str) -> str:
    """A client id that identifies its owner: program, user, machine and process, ``watch-ann-lab2-4711``.

    At most 100 characters, letters, digits, ``.``, ``_`` and ``-``; unique in this process.
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
