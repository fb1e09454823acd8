"""The daemon: answers commands; it owns the machine, the actions and the publisher."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np

from bus import topics
from bus.codec import bus_schema, decode
from bus.codes import ADVICE, Code
from bus.commands import CellHealth, CommandReply, CommandRequest, DoorHealth, Heartbeat, ResultRequest
from bus.errors import BadPayload, BusError, CycleFailure, DriverError, Refused
from bus.frozen import Message
from bus.messages import CycleResult, PictureRequest
from bus.sample import Asked, Sample
from bus.session import Bus
from bus.topics import Topic
from cell.daemon.actions import Actions
from cell.daemon.batch_control import BatchControl
from cell.daemon.grip import Grip, GripHand
from cell.daemon.in_hand import InHand
from cell.daemon.live_picture import LivePictures
from cell.daemon.manual import Manual
from cell.daemon.pointed import Pointed
from cell.daemon.publisher import Observer, Publisher
from cell.daemon.sized_camera import SizedCamera
from cell.machine.hold_state import HoldState
from cell.machine.leases import CELL_CLIENT, Leases
from cell.machine.owner import TURN_S, Action, Machine, refuse
from cell.machine.states import MANUAL_MOTIONS, PAUSED, SETTLED, State, available
from cell.nodes.health import LOOK_PERIOD_S, NodeMonitor
from cell.nodes.speakers import Speakers, strange
from cell.nodes.watchdog import Watchdog
from cell.pick.equipment import Equipment
from cell.pick.plan_view import PlanViews
from config.schema import Station
from drivers.interface import Devices
from logs.live_views import Views
from logs.mcap.recorder import Under, plain
from perception.models import Models
from planning.reach import reaches
from planning.robot import Robot

_log = logging.getLogger(__name__)

_ANYONES = ("stop", "abort", "hold", "suspend")

_LONGEST_COMMAND = 64 * 1024
_CLOSE_PATIENCE_S = 25.0
_KEPT_RESULTS = 64
_KEPT_DEFECTS = 16


class Daemon:
    """Owns the cell on the bus until closed.

    Args:
        station: its configuration.
        bus: the cell's own (listening) session; remains the caller's to close.
        devices: connected devices, usually `drivers.remote`.
        robot: the planning model. ``models``: perception's.
        observer: called with every message of the daemon, on the publishing thread; it may only enqueue.
        restarts: gives the number of restarts of a node. ``end_frozen``: kills a frozen node.
        under: gives what a recording is written to, of its opened file.

    Raises: DriverError when a camera, an arm or a hand is missing.
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
        under: Under = plain,
    ) -> None:
        camera, arm, hand = devices.camera, devices.arm, devices.hand
        if camera is None or arm is None or hand is None:
            raise DriverError("The cell needs a camera, an arm and a hand.", "Check `serves` in the station file.")
        self._bus = bus
        views = Views(robot.base_from_tcp)
        self.publisher = Publisher(
            bus,
            views,
            observer,
            lambda: self._actions.cycle_id,
            lambda: self._batches.jobs,
            lambda: self._manual.mode,
            lambda: self._in_hand.tell(),
            lambda: self._actions.asked_by or self._batches.asked_by,
        )
        hold_state = HoldState()
        sized = SizedCamera(camera)
        grip = Grip(station.hand, station.verify.min_width_m)
        self._in_hand = InHand(grip, self.publisher)
        equipment = Equipment(sized, arm, GripHand(hand, grip), robot, station, models)
        self._manual = Manual(equipment, hold_state.gate, self.publisher, self._post_stop)
        self._pointed = Pointed()
        self._actions = Actions(
            equipment,
            hold_state.gate,
            devices.presenter,
            lambda: bus.alive(topics.NODE_ALIVE),
            self._publish,
            self.publisher.publish_stage,
            self._on_result,
            self._on_fault,
            under,
            grip,
        )
        self._monitor = NodeMonitor(station, self._on_lost, restarts, bus.clock)
        reads_text = models.read_text(station)
        self._batches = BatchControl(
            self._actions,
            self.publisher,
            station,
            reads_text=reads_text,
            rest=self._manual.rest,
            resolved=self._pointed.resolved,
            picture_px=lambda: sized.size_px,
            reaches=lambda place_m: reaches(robot.arm, np.array(place_m)) if station.robot is None else True,
        )
        of_holder = frozenset({"approve"} if station.execute.approve == "holder" else ())
        self._leases = Leases(
            self._batches.lose_lease, station.silence_s, LOOK_PERIOD_S, clock=bus.clock, of_holder=of_holder
        )
        self._watchdog = Watchdog(
            station,
            self._monitor,
            partial(self.publisher.publish, topics.HEALTH),
            end_frozen,
            self._leases.look,
            self.health,
        )
        ours = [name for name, node in station.nodes.items() if node.run == "here"]
        self._speakers = Speakers(bus, set(station.nodes), self._on_node_twice, self._on_stranger, sealed=ours)
        self._plan_views = PlanViews(self._actions.approvals, robot, station)
        self._live = LivePictures(equipment, self._is_at_rest, self._is_held, self._pointed, bus.clock.now_s)
        self._results: OrderedDict[str, CycleResult] = OrderedDict()
        self._defects: tuple[str, ...] = ()
        self._doors: dict[str, DoorHealth] = {}
        self._published_s = -TURN_S
        self.machine = Machine(
            self._actions_by_state(),
            hold_state,
            self._batches.enter,
            self._batches.accept,
            self._beside,
            on_turn=self._turn,
        )
        self._batches.drive(self.machine)

    def _publish(self, topic: Topic, message: Message | bytes) -> None:
        """Publish what a cycle says; whoever sees it may point into it at once."""
        self._pointed.hear(message)
        self.publisher.publish(topic, message)

    def _is_at_rest(self) -> bool:
        """No cycle is open, none is to follow, and nothing moves: a picture is nobody's concern but the asker's."""
        is_settled = self.machine.state in SETTLED and not self._manual.is_moving
        return is_settled and not self._batches.jobs[0] and self._actions.log is None

    def _is_held(self) -> bool:
        """Nothing moves until somebody lets it go on."""
        return self.machine.state in PAUSED and not self._manual.is_moving

    def _beside(self, verb: str, request: CommandRequest, state: State) -> CommandReply | None:
        return self._manual.beside(verb, request, state) or self._batches.beside(verb, request, state)

    def _post_stop(self, reason: str) -> None:
        self.machine.post("stop", CommandRequest(client_id=CELL_CLIENT), reason)

    def _actions_by_state(self) -> dict[State, Action]:
        actions = self._actions
        return {
            State.RESETTING: self._reset,
            State.STARTING: actions.begin,
            State.EXECUTE: actions.pick,
            State.COMPLETING: actions.complete,
            State.HOLDING: actions.hold,
            State.UNHOLDING: actions.unhold,
            State.SUSPENDING: actions.hold,
            State.UNSUSPENDING: actions.unhold,
            State.STOPPING: lambda: actions.stop(self.machine.wait_no_action),
            State.ABORTING: lambda: actions.stop(self.machine.wait_no_action),
            State.CLEARING: actions.clear,
        }

    def _reset(self) -> None:
        """Reset. Raises: CycleFailure when the watchdog has ended, and as `Actions.reset`."""
        if not self._watchdog.is_alive():
            raise CycleFailure(Code.INTERNAL, "Nobody watches the nodes any more: end this cell and start it again.")
        self._actions.reset()

    def open(self) -> None:
        """Begin to answer commands; the machine begins in Stopped."""
        self._bus.tap = self._record
        for topic in topics.TOPICS:
            if topic.kind == "publish" and topic.logged:
                self._bus.subscribe(topic.key.replace("{name}", "*"), self._hear)
        self._speakers.listen()
        self._monitor.listen(self._bus)
        self._leases.listen(self._bus)
        # first, so that whoever has the state reaches the commands, too: `Client.send` relies on it
        self._bus.answer(topics.COMMAND, self._on_command, worker=self._worker_of, verb="*")
        self._bus.answer(topics.STATE_NOW, lambda _payload, _asked: self.publisher.state, worker="state")
        self._bus.answer(topics.HEALTH_NOW, lambda _payload, _asked: self.health(), worker="state")
        self._bus.answer(topics.RESULT_NOW, self._on_result_asked, worker="state")
        self._bus.answer(topics.PROPOSAL_NOW, lambda _payload, _asked: self._proposal(), worker="state")
        self._bus.answer(topics.PLAN_NOW, lambda _payload, _asked: self._plan_views.now(), worker="plan")
        self._bus.answer(topics.PICTURE_NOW, self._on_picture_asked, worker="picture")
        self._bus.answer(topics.SCHEMA_NOW, lambda _payload, _asked: bus_schema(), worker="schema")
        self._bus.announce(topics.LEASE, name=CELL_CLIENT)
        self.machine.start()
        self._watchdog.start()

    def close(self) -> None:
        """Stop all actions, then end the machine; idempotent."""
        self._manual.end("the cell ends")
        if "stop" in available(self.machine.state):
            self.command("stop", CommandRequest(client_id=CELL_CLIENT))
        now_s = self._bus.clock.now_s
        give_up_s = now_s() + _CLOSE_PATIENCE_S
        while self.machine.state in (State.STOPPING, State.ABORTING) and now_s() < give_up_s:
            time.sleep(0.02)
        self._watchdog.close()
        self.machine.close()

    def command(self, verb: str, request: CommandRequest) -> CommandReply:
        """Send a command from inside this process; equivalent to one over the bus."""
        return self.machine.command(verb, request)

    def health(self) -> CellHealth:
        """The cell's health now: its nodes, its doors, and the defects of this process."""
        nodes, doors = self._monitor.health().nodes, dict(self._doors)
        health = CellHealth(is_healthy=True, nodes=nodes, doors=doors, defects=self._defects)
        return health.model_copy(update={"is_healthy": not health.problems})

    def hear_door(self, name: str, health: DoorHealth) -> None:
        """Take how a door is now; from any thread."""
        self._doors = {**self._doors, name: health}

    def is_ours(self, sample: Sample) -> bool:
        """True for a sample of one of the cell's own nodes."""
        return self._speakers.is_ours(sample)

    def objects_left(self) -> int | None:
        """Simulation: number of objects really in the pick region; None when unknown."""
        try:
            return self._actions.table.left()
        except (DriverError, BusError) as error:
            _log.warning("%s", error)
            return None

    # --- the nodes ----------------------------------------------------------------------------------------------------

    def lose_node(self, name: str, text: str) -> None:
        """Handle the end of a node's process: all motion stops, and the machine aborts with the node's name."""
        self._on_lost(name, CycleFailure(Code.NODE_LOST, text))

    def welcome_node(self, name: str) -> None:
        """Publish that a node is back; nothing moves by itself."""
        self.publisher.publish_event(
            "NODE_BACK", "info", f"The node {name!r} was started again.", ADVICE[Code.NODE_LOST]
        )

    def _on_lost(self, _name: str, failure: CycleFailure) -> None:
        self._on_fault(failure)

    def _on_fault(self, failure: CycleFailure) -> None:
        """Handle a failure outside any stage: all motion stops, and the machine aborts with its reason."""
        self.machine.fault(failure)

    def on_defect(self, name: str, defect: BaseException) -> None:
        """Handle an unforeseen exception that ended an owned thread of this process: the cell aborts."""
        text = f"{name} ended: {type(defect).__name__}: {defect}."
        self._defects = (*self._defects, text)[-_KEPT_DEFECTS:]
        self.machine.defect(CycleFailure(Code.INTERNAL, text))
        if not self.machine.is_owned:  # no owner thread can abort any more: at least stop the devices
            self._actions.halt_devices()

    def _on_node_twice(self, name: str, who: str) -> None:
        text = f"Two nodes are called {name!r}: {who}. Both would carry out every motion."
        self._on_fault(CycleFailure(Code.NODE_LOST, text))

    # --- messages of others -------------------------------------------------------------------------------------------

    def _on_command(self, payload: bytes, asked: Asked) -> Message:
        request, verb = decode(CommandRequest, payload), asked.verb
        if request.client_id == CELL_CLIENT:
            raise Refused(f"The client id {CELL_CLIENT!r} is the cell's own.", "Send another.", code="BAD_CLIENT")
        self._leases.require(verb, request.client_id, asked.received_s)
        reply = self.machine.command(verb, request)
        refuse(reply)
        if verb in MANUAL_MOTIONS:
            self._manual.run(verb, request)
        lease = self._leases.take(verb, request.client_id, asked.source)
        return reply.model_copy(update={"lease": lease, "since_ns": self.publisher.state.since_ns})

    def _worker_of(self, asked: Asked, payload: bytes) -> str:
        """The worker for a command, so that a stop waits for no other command.

        Commands whose token is still awaited have a worker of their own, so that no other command waits for them.
        """
        if asked.verb in _ANYONES:
            return "command-stop"
        try:
            client_id = decode(CommandRequest, payload).client_id if len(payload) < _LONGEST_COMMAND else ""
        except BadPayload:
            return "command-refused"
        return "command-awaited" if self._leases.must_wait(asked.verb, client_id) else "command"

    def _on_result_asked(self, payload: bytes, _asked: Asked) -> Message:
        cycle_id = decode(ResultRequest, payload).cycle_id
        result = self._results.get(cycle_id)
        if result is None:
            text = f"There is no result of a cycle {cycle_id!r}: it is not over, or was not one of the last."
            raise Refused(text, "Recorded ones: `cell cycles`.", code="NO_RESULT")
        return result

    def _on_picture_asked(self, payload: bytes, _asked: Asked) -> Message:
        return self._live.now(decode(PictureRequest, payload))

    def _proposal(self) -> Message:
        waiting = self._actions.approvals.waiting
        if waiting is None:
            raise Refused(
                "No planned motion waits for an answer.",
                "A cycle asks in its stage `approve`, where execute.approve is not 'no'.",
                code="NO_PROPOSAL",
            )
        return waiting

    def _record(self, sample: Sample) -> None:
        """Record a message of this process, or a reply to it."""
        log = self._actions.log
        if log is not None:
            log.hear(sample)

    def _hear(self, sample: Sample) -> None:
        """Process a message that another process published on the cell's keys."""
        if self._speakers.is_ours(sample):
            self._record(sample)
            self._monitor.hear(sample)
            self._in_hand.hear(sample)
        else:
            self._record(strange(sample))

    def _on_stranger(self, sample: Sample) -> None:
        who = f"session {sample.source[:8]}" if sample.source else "a program that does not say who it is"
        self.publisher.publish_event(
            "STRANGER",
            "warning",
            f"{who} put something on {sample.key!r}, which is not its to say: it is recorded apart, and not believed.",
            "Find the program; only the cell and its nodes publish below cell/CELL_ID.",
        )

    # --- callbacks of the actions -------------------------------------------------------------------------------------

    def _on_result(self, result: CycleResult) -> None:
        self._results[result.cycle_id] = result
        while len(self._results) > _KEPT_RESULTS:
            self._results.popitem(last=False)
        self._batches.count(result)

    def _turn(self) -> None:
        """On the machine's owner thread, several times a second: prove that a stop would be answered; see the hand."""
        self._publish_heartbeat()
        self._in_hand.look(self.machine.state)

    def _publish_heartbeat(self) -> None:
        if time.monotonic() - self._published_s >= TURN_S / 2:
            self._published_s = time.monotonic()
            with suppress(BusError):  # closing
                self._bus.publish(topics.HEARTBEAT, Heartbeat())
