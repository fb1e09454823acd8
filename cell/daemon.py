"""The daemon: answers commands, owns the machine, and says what happens on the bus."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping

from bus import topics
from bus.codec import decode
from bus.codes import ADVICE, Code
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest, Event
from bus.errors import BusError, CycleFailure, DriverError, RecordingError, Refused
from bus.faulty import answer_faults
from bus.frozen import Message
from bus.messages import Attempt, CycleResult
from bus.session import Bus, Heard
from bus.topics import Topic
from cell.batch import Batch
from cell.cycle import Equipment
from cell.health import LOOK_PERIOD_S, Watch
from cell.leases import CELL_CLIENT, Leases
from cell.machine import Machine
from cell.states import COMMANDS, PAUSES, State, available
from cell.works import Works, new_cycle_id
from config.schema import Station
from drivers.interface import Devices
from logs.faulty import FaultyDisk
from logs.recorder import plain
from logs.recover import Recovered
from logs.views import Views
from perception.models import Models
from perception.models.faulty import FaultyModel
from planning.robot import Robot

_log = logging.getLogger(__name__)

_ANYONES = ("stop", "abort", "hold", "suspend")

Observer = Callable[[Topic, "Message | bytes"], None]

_CLOSE_PATIENCE_S = 25.0
_HEALTH_PERIOD_S = 1.0


class Daemon:
    """Owns the cell on the bus until closed.

    Args:
        station: its configuration.
        bus: the cell's own (listening) session; stays the caller's to close.
        devices: connected devices, usually `drivers.remote`.
        robot: the planning model. ``models``: perception's.
        observer: told everything the daemon says, on the thread that says it; it may only enqueue.
        restarts, end_frozen: of the nodes' supervisor: how often a node was brought back; end one that hangs.
    """

    def __init__(
        self,
        station: Station,
        bus: Bus,
        devices: Devices,
        robot: Robot,
        models: Models,
        observer: Observer,
        restarts: Callable[[str], int] = lambda name: 0,
        end_frozen: Callable[[str], None] = lambda name: None,
    ) -> None:
        camera, arm, hand = devices.camera, devices.arm, devices.hand
        if camera is None or arm is None or hand is None:
            raise DriverError("The cell needs a camera, an arm and a hand.", "Check `serves` in the station file.")
        self._station, self._bus, self._observer = station, bus, observer
        equipment = Equipment(camera, arm, hand, robot, station, models)
        faults = station.faults
        self._disk = FaultyDisk(faults.disk, delay_s=faults.delay_s) if faults.allowed else None
        self._imaginer = models.imaginer
        self._works = works = Works(
            equipment,
            devices.feeder,
            lambda: bus.alive(topics.NODE_ALIVE),
            self._say,
            self._on_stage,
            self._on_result,
            self._on_fault,
            self._disk.under if self._disk is not None else plain,
        )
        self._watch = Watch(station, self._on_lost, restarts)
        self._end_frozen = end_frozen
        self._leases = Leases(self._on_lease_lost)
        self._unattended = ""  # the lost lease as a reason, until the hold begins or somebody takes over
        self._closing = threading.Event()
        self._watchdog = threading.Thread(target=self._watch_over, name="watchdog", daemon=True)
        self._batch: Batch | None = None
        self._may_hold = False  # a start may, a single pick ends
        self._views = Views(robot.base_from_tcp)
        self._saying = threading.Lock()
        self._said_state = CellState(state="", stage="", cycle_id="", since_ns=0, available=(), reason="")
        self.machine = Machine(
            {
                State.RESETTING: works.reset,
                State.STARTING: works.begin,
                State.EXECUTE: works.pick,
                State.COMPLETING: works.complete,
                State.HOLDING: works.hold,
                State.UNHOLDING: works.unhold,
                State.SUSPENDING: works.hold,
                State.UNSUSPENDING: works.unhold,
                State.STOPPING: lambda: works.stop(self.machine.wait_quiet),
                State.ABORTING: lambda: works.stop(self.machine.wait_quiet),
                State.CLEARING: works.clear,
            },
            self._on_state,
            self._on_accept,
        )

    def open(self) -> None:
        """Answer commands; the machine begins in Stopped."""
        self._bus.tap = self._hear
        for topic in topics.TOPICS:
            if topic.kind == "publish" and topic.logged:
                self._bus.subscribe(topic.key.replace("{name}", "*"), self._hear)
        self._watch.listen(self._bus)
        self._leases.listen(self._bus)
        self._bus.answer(topics.STATE_NOW, lambda _payload, _fields: self._said_state, lane="state")
        self._bus.answer(topics.HEALTH_NOW, lambda _payload, _fields: self._watch.health(), lane="state")
        self._bus.answer(topics.COMMAND, self._on_command, lane=_lane_of, verb="*")
        if self._disk is not None and isinstance(self._imaginer, FaultyModel):
            answer_faults(self._bus, {"disk": self._disk, "model": self._imaginer}, self._say)
        self._bus.announce(topics.LEASE, name=CELL_CLIENT)
        self.machine.start()
        self._watchdog.start()

    def close(self) -> None:
        """Stop what runs, then end the machine; idempotent."""
        if "stop" in available(self.machine.state):
            self.command("stop", CommandRequest(client_id=CELL_CLIENT))
        give_up_s = time.monotonic() + _CLOSE_PATIENCE_S
        while self.machine.state in (State.STOPPING, State.ABORTING) and time.monotonic() < give_up_s:
            time.sleep(0.02)
        self._closing.set()
        if self._watchdog.is_alive():
            self._watchdog.join()
        self.machine.close()

    def command(self, verb: str, request: CommandRequest) -> CommandReply:
        """A command from inside this process; the same as one over the bus."""
        return self.machine.command(verb, request)

    def health(self) -> CellHealth:
        """The cell's health now, node by node."""
        return self._watch.health()

    def objects_left(self) -> int | None:
        """Simulation: how many objects really are in the pick region; None where nobody knows."""
        try:
            return self._works.feed.left()
        except (DriverError, BusError) as error:
            _log.warning("%s", error)
            return None

    def tell_recovered(self, leftovers: Iterable[Recovered | RecordingError]) -> None:
        """Say what became of the recordings that an earlier process left unfinished."""
        for leftover in leftovers:
            if isinstance(leftover, RecordingError):
                event = Event(code="NOT_RECOVERED", severity="warning", text=leftover.text, advice=leftover.advice)
            else:
                event = Event(
                    code="RECOVERED", severity="warning" if leftover.lost else "info", text=f"{leftover.line()}."
                )
            self._say(topics.EVENT, event)

    # --- the nodes ----------------------------------------------------------------------------------------------------

    def lose_node(self, name: str, text: str) -> None:
        """A node's process ended: everything stops, and the machine aborts with its name."""
        self._on_lost(name, CycleFailure(Code.NODE_LOST, text))

    def welcome_node(self, name: str) -> None:
        """A node is back; nothing moves by itself."""
        text = f"The node {name!r} was started again."
        self._say(topics.EVENT, Event(code="NODE_BACK", severity="info", text=text, advice=ADVICE[Code.NODE_LOST]))

    def _on_lost(self, _name: str, failure: CycleFailure) -> None:
        self._on_fault(failure)

    def _on_fault(self, failure: CycleFailure) -> None:
        """Something outside any stage failed: whatever moves stops, and the machine aborts with its reason."""
        self.machine.fault(failure)  # before what it interrupts can end by itself
        self._works.gate.halt(failure)

    def _watch_over(self) -> None:
        """The watchdogs' thread: look often, say the cell's health once a second, and end what is frozen."""
        said_s = 0.0
        ended: set[str] = set()
        while not self._closing.wait(LOOK_PERIOD_S):
            self._watch.look()
            for name in self._station.nodes:
                is_frozen = self._watch.unheard_for_s(name) > self._station.bus.frozen_s
                if is_frozen and name not in ended:
                    self._end_frozen(name)
                ended = ended | {name} if is_frozen else ended - {name}
            if time.monotonic() - said_s >= _HEALTH_PERIOD_S:
                said_s = time.monotonic()
                self._say(topics.HEALTH, self._watch.health())

    # --- what others say ----------------------------------------------------------------------------------------------

    def _on_command(self, payload: bytes, fields: Mapping[str, str]) -> Message:
        request = decode(CommandRequest, payload or b"{}")
        if request.client_id == CELL_CLIENT:
            raise Refused(f"The client id {CELL_CLIENT!r} is the cell's own.", "Send another.", code="BAD_CLIENT")
        verb = fields["verb"]
        self._leases.require(verb, request.client_id)
        reply = self.machine.command(verb, request)
        if not reply.ok:
            return reply
        return reply.model_copy(update={"lease": self._leases.take(verb, request.client_id)})

    def _on_lease_lost(self, client_id: str) -> None:
        """Nobody attends the motion: it is held, or stopped where it cannot be; and no further cycle begins."""
        self._unattended = f"The lease of {client_id!r} was lost: nobody attends the motion."
        self._batch = None
        self._works.gate.hold()
        self._hold_unattended("stop" if self.machine.state is State.RESETTING else "hold")

    def _hold_unattended(self, verb: str = "hold") -> None:
        self.machine.post(verb, CommandRequest(client_id=CELL_CLIENT), self._unattended)

    def _hear(self, heard: Heard) -> None:
        log = self._works.log
        if log is not None:
            log.hear(heard)

    # --- what the owner thread asks -----------------------------------------------------------------------------------

    def _on_accept(self, verb: str, request: CommandRequest) -> str:
        """Called before an accepted command changes the state; says which cycle it begins."""
        own = request.client_id == CELL_CLIENT
        self._unattended = ""
        if verb in ("stop", "abort"):
            self._batch = None
            self._works.gate.halt()
        elif verb in ("hold", "suspend"):
            self._works.gate.hold()
        elif verb in ("reset", "clear") and not own:
            self._batch = None
            self._works.renew()
            self._works.gate.clear()
        elif verb in ("start", "pick") and not own:
            self._require_possible(request)
            self._may_hold = verb == "start"
            self._batch = Batch(request if verb == "start" else CommandRequest(), self._station.retry)
            attempt = Attempt(cycle_id=new_cycle_id())
            self._works.renew(attempt)
            self._works.object = request.object
            self._works.gate.clear()
            return attempt.cycle_id
        return ""

    def _require_possible(self, request: CommandRequest) -> None:
        """Raises: Refused for what the simulated table cannot do."""
        clutter = self._station.sim.clutter if self._station.simulated else None
        if request.until_empty and clutter == 0:
            raise Refused(
                "Every cycle brings a new object: the table is never empty.",
                "Use config/bin.toml, or set sim.clutter.",
                code="NEVER_EMPTY",
            )
        if request.object is not None and clutter:
            raise Refused(
                f"The table was filled at the start: {request.object!r} cannot be presented.",
                "Pick without naming an object, or set sim.clutter = 0.",
                code="TABLE_FILLED",
            )

    def _on_state(self, state: State, reason: str) -> None:
        """Say the new state, and go on with the next cycle of a ``start``."""
        with self._saying:
            self._say_state(state, reason=reason, stage=self._stage_held(state))
        if reason and state in (State.ABORTING, State.ABORTED):
            self._say(topics.EVENT, Event(code=state.upper(), severity="error", text=reason))
        if self._unattended and state in COMMANDS["hold"]:  # it was lost while the cycle was starting
            self._hold_unattended()
        if state is State.COMPLETING:
            self._hold_if_it_gave_up()
        own = CommandRequest(client_id=CELL_CLIENT)
        goes_on = self._batch is not None and not self._batch.is_over
        if state is State.COMPLETE and goes_on:
            self.machine.post("reset", own)
        elif state is State.IDLE and goes_on:
            self.machine.post("start", own)
        elif state in (State.STOPPING, State.ABORTING):
            self._batch = None

    def _hold_if_it_gave_up(self) -> None:
        """On the owner thread, before the delivery begins: after too many failures somebody must look first."""
        why, self._works.gave_up = self._works.gave_up, ""
        if why and self._may_hold:
            self._say(topics.EVENT, Event(code="GAVE_UP", severity="error", text=why))
            self._works.gate.hold()
            self.machine.post("hold", CommandRequest(client_id=CELL_CLIENT), why)

    # --- what we say --------------------------------------------------------------------------------------------------

    def _say(self, topic: Topic, message: Message | bytes) -> None:
        try:
            self._bus.publish(topic, message)
            for view, picture in self._views.of(message):
                self._bus.publish(view, picture)
        except BusError as error:  # closing: the observer below still hears it
            _log.warning("%s", error)
        self._observer(topic, message)

    def _on_result(self, result: CycleResult) -> None:
        """Count it in the running ``start``; say so when that gives up."""
        batch = self._batch
        if batch is None:
            return
        batch.hear(result)
        if batch.gave_up:
            self._say(topics.EVENT, Event(code="GAVE_UP", severity="error", text=batch.reason))

    def _on_stage(self, stage: str) -> None:
        with self._saying:  # read and said together: the owner thread may be changing it
            self._say_state(self.machine.state, stage=stage)

    def _stage_held(self, state: State) -> str:
        """The stage that a new state leaves open: a hold, and the way back from it, keep the cycle's."""
        was_held = self._said_state.state in PAUSES and state in COMMANDS["hold"]
        return self._said_state.stage if was_held or state in PAUSES else ""

    def _say_state(self, state: State, *, reason: str = "", stage: str = "") -> None:
        self._said_state = CellState(
            state=state,
            stage=stage,
            cycle_id=self._works.cycle_id,
            since_ns=time.time_ns(),
            available=available(state),
            reason=reason,
        )
        self._say(topics.STATE, self._said_state)


def _lane_of(verb: str) -> str:
    """What stops the arm never waits behind a command that is still being looked into."""
    return "command-stop" if verb in _ANYONES else "command"
