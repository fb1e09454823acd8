"""The daemon: a unit on the bus, which it answers and hears, with its nodes watched."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from bus import topics
from bus.codes import Code
from bus.commands import CellHealth, CommandReply, CommandRequest, DoorHealth
from bus.errors import CycleFailure
from bus.sample import Sample
from bus.session import Bus
from cell.daemon.answers import Answers
from cell.daemon.hearing import Hearing
from cell.daemon.publisher import Observer
from cell.daemon.unit import Unit
from cell.machine.leases import CELL_CLIENT, Leases
from cell.machine.states import State, available
from cell.nodes.health import LOOK_PERIOD_S, NodeMonitor
from cell.nodes.watchdog import Watchdog
from cell.pick.plan_view import PlanViews
from config.schema import Station
from drivers.interface import Devices
from logs.mcap.recorder import Under, plain
from perception.models import Models
from planning.robot import Robot

_CLOSE_PATIENCE_S = 25.0
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

    Attributes:
        machine: the states of the cell. ``publisher``: publishes what it says.

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
        self._bus = bus
        self._defects: tuple[str, ...] = ()
        self._doors: dict[str, DoorHealth] = {}
        self._unit = Unit(
            station, bus, devices, robot, models, observer, under, is_watched=lambda: self._watchdog.is_alive()
        )
        self.machine, self.publisher = self._unit.machine, self._unit.publisher
        self._monitor = NodeMonitor(station, self._on_lost, restarts, bus.clock)
        of_holder = frozenset({"approve"} if station.execute.approve == "holder" else ())
        self._leases = Leases(
            self._unit.lose_lease, station.silence_s, LOOK_PERIOD_S, clock=bus.clock, of_holder=of_holder
        )
        say_health = partial(self.publisher.publish, topics.HEALTH)
        self._watchdog = Watchdog(station, self._monitor, say_health, end_frozen, self._leases.look, self.health)
        self._hearing = Hearing(bus, station, self._unit, self._monitor, self._on_node_twice)
        plan_views = PlanViews(self._unit.actions.approvals, robot, station)
        self._answers = Answers(bus, self._unit, self._leases, plan_views, self.health)

    def open(self) -> None:
        """Begin to answer commands; the machine begins in Stopped."""
        self._hearing.begin()
        self._leases.listen(self._bus)
        self._answers.begin()
        self._bus.announce(topics.LEASE, name=CELL_CLIENT)
        self.machine.start()
        self._watchdog.start()

    def close(self) -> None:
        """Stop all actions, then end the machine; idempotent."""
        self._unit.manual.end("the cell ends")
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

    def is_ours(self, sample: Sample) -> bool:
        """Return whether a sample is of one of the cell's own nodes."""
        return self._hearing.is_ours(sample)

    def objects_left(self) -> int | None:
        """Return the number of objects really in the pick region of a simulated cell; None when it is unknown."""
        return self._unit.objects_left()

    # --- its health ---------------------------------------------------------------------------------------------------

    def health(self) -> CellHealth:
        """Return the cell's health now: its nodes, its doors, and the defects of this process."""
        nodes, doors = self._monitor.health().nodes, dict(self._doors)
        health = CellHealth(is_healthy=True, nodes=nodes, doors=doors, defects=self._defects)
        return health.model_copy(update={"is_healthy": not health.problems})

    def hear_door(self, name: str, health: DoorHealth) -> None:
        """Take how a door is now; from any thread."""
        self._doors = {**self._doors, name: health}

    def on_defect(self, name: str, defect: BaseException) -> None:
        """Handle an unforeseen exception that ended an owned thread of this process: the cell aborts."""
        text = f"{name} ended: {type(defect).__name__}: {defect}."
        self._defects = (*self._defects, text)[-_KEPT_DEFECTS:]
        self.machine.defect(CycleFailure(Code.INTERNAL, text))
        if not self.machine.is_owned:  # no owner thread can abort any more: at least stop the devices
            self._unit.actions.halt_devices()

    # --- its nodes ----------------------------------------------------------------------------------------------------

    def lose_node(self, name: str, text: str) -> None:
        """Handle the end of a node's process: all motion stops, and the machine aborts with the node's name."""
        self._on_lost(name, CycleFailure(Code.NODE_LOST, text))

    def welcome_node(self, name: str) -> None:
        """Publish that a node is back; nothing moves by itself."""
        ready = "Now `cell clear` and `cell reset` make the cell ready."
        self.publisher.publish_event("NODE_BACK", "info", f"The node {name!r} was started again.", ready)

    def _on_lost(self, _name: str, failure: CycleFailure) -> None:
        self.machine.fault(failure)

    def _on_node_twice(self, name: str, who: str) -> None:
        text = f"Two nodes are called {name!r}: {who}. Both would carry out every motion."
        self.machine.fault(CycleFailure(Code.NODE_LOST, text))
