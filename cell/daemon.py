"""The daemon: answers commands, and owns the machine, the works and what is said of them on the bus."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from functools import partial

from bus import topics
from bus.codec import decode
from bus.codes import ADVICE, Code
from bus.commands import CellHealth, CommandReply, CommandRequest
from bus.errors import BusError, CycleFailure, DriverError, Refused
from bus.faulty import answer_faults
from bus.frozen import Message
from bus.heard import Heard
from bus.messages import Attempt, CycleResult
from bus.session import Bus
from cell.batch import Batch
from cell.cycle import Equipment
from cell.health import Watch
from cell.leases import CELL_CLIENT, Leases
from cell.machine import Machine, Work
from cell.states import COMMANDS, State, available
from cell.voice import Observer, Voice
from cell.watchdog import Watchdog
from cell.works import Works, new_cycle_id
from config.schema import Station
from drivers.interface import Devices
from logs.faulty import FaultyDisk
from logs.recorder import plain
from logs.views import Views
from perception.models import Models
from perception.models.faulty import FaultyModel
from planning.robot import Robot

_log = logging.getLogger(__name__)

_ANYONES = ("stop", "abort", "hold", "suspend")

_CLOSE_PATIENCE_S = 25.0


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
        self._station, self._bus = station, bus
        faults = station.faults
        self._disk = FaultyDisk(faults.disk, delay_s=faults.delay_s) if faults.allowed else None
        self._imaginer = models.imaginer
        self.voice = Voice(bus, Views(robot.base_from_tcp), observer, lambda: self._works.cycle_id)
        self._works = Works(
            Equipment(camera, arm, hand, robot, station, models),
            devices.feeder,
            lambda: bus.alive(topics.NODE_ALIVE),
            self.voice.say,
            self.voice.say_stage,
            self._on_result,
            self._on_fault,
            self._disk.under if self._disk is not None else plain,
        )
        self._watch = Watch(station, self._on_lost, restarts)
        self._watchdog = Watchdog(station, self._watch, partial(self.voice.say, topics.HEALTH), end_frozen)
        self._leases = Leases(self._on_lease_lost)
        self._unattended = ""  # the lost lease as a reason, until the hold begins or somebody takes over
        self._batch: Batch | None = None
        self._may_hold = False  # a start may, a single pick ends
        self.machine = Machine(self._works_by_state(), self._on_state, self._on_accept)

    def _works_by_state(self) -> dict[State, Work]:
        works = self._works
        return {
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
        }

    def open(self) -> None:
        """Answer commands; the machine begins in Stopped."""
        self._bus.tap = self._hear
        for topic in topics.TOPICS:
            if topic.kind == "publish" and topic.logged:
                self._bus.subscribe(topic.key.replace("{name}", "*"), self._hear)
        self._watch.listen(self._bus)
        self._leases.listen(self._bus)
        self._bus.answer(topics.STATE_NOW, lambda _payload, _fields: self.voice.state, lane="state")
        self._bus.answer(topics.HEALTH_NOW, lambda _payload, _fields: self._watch.health(), lane="state")
        self._bus.answer(topics.COMMAND, self._on_command, lane=_lane_of, verb="*")
        if self._disk is not None and isinstance(self._imaginer, FaultyModel):
            answer_faults(self._bus, {"disk": self._disk, "model": self._imaginer}, self.voice.say)
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
        self._watchdog.close()
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

    # --- the nodes ----------------------------------------------------------------------------------------------------

    def lose_node(self, name: str, text: str) -> None:
        """A node's process ended: everything stops, and the machine aborts with its name."""
        self._on_lost(name, CycleFailure(Code.NODE_LOST, text))

    def welcome_node(self, name: str) -> None:
        """A node is back; nothing moves by itself."""
        self.voice.say_event("NODE_BACK", "info", f"The node {name!r} was started again.", ADVICE[Code.NODE_LOST])

    def _on_lost(self, _name: str, failure: CycleFailure) -> None:
        self._on_fault(failure)

    def _on_fault(self, failure: CycleFailure) -> None:
        """Something outside any stage failed: whatever moves stops, and the machine aborts with its reason."""
        self.machine.fault(failure)  # before what it interrupts can end by itself
        self._works.gate.halt(failure)

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
            return self._begin(verb, request)
        return ""

    def _begin(self, verb: str, request: CommandRequest) -> str:
        """The picks of a ``start``, or the one of a ``pick``; the first one's cycle id. Raises: Refused."""
        self._works.feed.require_possible(request)
        self._may_hold = verb == "start"
        self._batch = Batch(request if verb == "start" else CommandRequest(), self._station.retry)
        attempt = Attempt(cycle_id=new_cycle_id())
        self._works.renew(attempt)
        self._works.object = request.object
        self._works.gate.clear()
        return attempt.cycle_id

    def _on_state(self, state: State, reason: str) -> None:
        """Say the new state, and do what it makes due."""
        self.voice.say_state(state, reason)
        if reason and state in (State.ABORTING, State.ABORTED):
            self.voice.say_event(state.upper(), "error", reason)
        if self._unattended and state in COMMANDS["hold"]:  # it was lost while the cycle was starting
            self._hold_unattended()
        if state is State.COMPLETING:
            self._hold_if_it_gave_up()
        self._go_on(state)

    def _go_on(self, state: State) -> None:
        """With the next cycle of a ``start``."""
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
            self.voice.say_event("GAVE_UP", "error", why)
            self._works.gate.hold()
            self.machine.post("hold", CommandRequest(client_id=CELL_CLIENT), why)

    def _on_result(self, result: CycleResult) -> None:
        """Count it in the running ``start``; say so when that gives up."""
        batch = self._batch
        if batch is None:
            return
        batch.hear(result)
        if batch.gave_up:
            self.voice.say_event("GAVE_UP", "error", batch.reason)


def _lane_of(verb: str) -> str:
    """What stops the arm never waits behind a command that is still being looked into."""
    return "command-stop" if verb in _ANYONES else "command"
