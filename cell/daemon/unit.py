"""The unit, as PackML calls it: the machine, what it does in each state, its two modes, and who publishes all that.

Its parts ask each other: the publisher is made first, and asks the later ones only when it publishes.
"""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from bus import topics
from bus.codes import Code
from bus.commands import CommandReply, CommandRequest, Heartbeat
from bus.errors import BusError, CycleFailure, DriverError
from bus.frozen import Message
from bus.messages import CycleResult
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
from cell.machine.leases import CELL_CLIENT
from cell.machine.owner import TURN_S, Action, Machine
from cell.machine.states import PAUSED, SETTLED, State
from cell.pick.equipment import Equipment
from config.base import Vector
from config.schema import Station
from drivers.interface import Devices
from logs.live_views import Views
from logs.mcap.recorder import Under
from perception.models import Models
from planning.reach import reaches
from planning.robot import Robot

_log = logging.getLogger(__name__)
_KEPT_RESULTS = 64


class Unit:
    """Picks, or is moved by hand, as its commands say.

    Args:
        observer, under: as of `cell.daemon.daemon.Daemon`.
        is_watched: whether somebody watches the nodes; otherwise nothing is reset.

    Attributes:
        machine: the states, and the thread that owns them.
        publisher: publishes what the cell says.
        actions: what the machine does in its states. ``manual``: the mode Manual. ``in_hand``: what may be held.
        pictures: taken on request.

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
        under: Under,
        is_watched: Callable[[], bool],
    ) -> None:
        camera, arm, hand = devices.camera, devices.arm, devices.hand
        if camera is None or arm is None or hand is None:
            raise DriverError("The cell needs a camera, an arm and a hand.", "Check `serves` in the station file.")
        self._bus, self._is_watched = bus, is_watched
        self._results: OrderedDict[str, CycleResult] = OrderedDict()
        self._published_s = -TURN_S
        self.publisher = self._make_publisher(robot, observer)
        hold_state, grip, sized = HoldState(), Grip(station.hand, station.verify.min_width_m), SizedCamera(camera)
        equipment = Equipment(sized, arm, GripHand(hand, grip), robot, station, models)
        self.in_hand = InHand(grip, self.publisher)
        self.manual = Manual(equipment, hold_state.gate, self.publisher, self._post_stop)
        self._pointed = Pointed()
        self.actions = Actions(
            equipment, hold_state.gate, devices.presenter, lambda: bus.alive(topics.NODE_ALIVE), self._publish,
            self.publisher.publish_stage, self._on_result, self._on_fault, under, grip,
        )  # fmt: skip
        self._batches = BatchControl(
            self.actions,
            self.publisher,
            station,
            reads_text=models.read_text(station),
            rest=self.manual.rest,
            resolved=self._pointed.resolved,
            picture_px=lambda: sized.size_px,
            reaches=_reaches(station, robot),
        )
        self.machine = Machine(
            self._actions_by_state(), hold_state, self._batches.enter, self._batches.accept, self._beside, self._turn
        )
        self._batches.drive(self.machine)
        self.pictures = LivePictures(equipment, self._is_at_rest, self._is_held, self._pointed, bus.clock.now_s)

    def _make_publisher(self, robot: Robot, observer: Observer) -> Publisher:
        return Publisher(
            self._bus,
            Views(robot.base_from_tcp),
            observer,
            lambda: self.actions.cycle_id,
            lambda: self._batches.jobs,
            lambda: self.manual.mode,
            lambda: self.in_hand.tell(),
            lambda: self.actions.asked_by or self._batches.asked_by,
        )

    def _actions_by_state(self) -> dict[State, Action]:
        actions = self.actions
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

    def lose_lease(self, client_id: str, why: str) -> None:
        """End the batch and hold: no client attends the motion any more. Any thread may call it."""
        self._batches.lose_lease(client_id, why)

    def result(self, cycle_id: str) -> CycleResult | None:
        """Return the result of one of the last cycles; None of another, or of one that is not over."""
        return self._results.get(cycle_id)

    def objects_left(self) -> int | None:
        """Return the number of objects really in the pick region of a simulated cell; None when it is unknown."""
        try:
            return self.actions.table.left()
        except (DriverError, BusError) as error:
            _log.warning("%s", error)
            return None

    # --- whether it rests ---------------------------------------------------------------------------------------------

    def _is_at_rest(self) -> bool:
        """No cycle is open, none is to follow, and nothing moves: a picture is nobody's concern but the asker's."""
        is_settled = self.machine.state in SETTLED and not self.manual.is_moving
        return is_settled and not self._batches.jobs[0] and self.actions.log is None

    def _is_held(self) -> bool:
        """Nothing moves until somebody lets it go on."""
        return self.machine.state in PAUSED and not self.manual.is_moving

    # --- callbacks of the machine -------------------------------------------------------------------------------------

    def _beside(self, verb: str, request: CommandRequest, state: State) -> CommandReply | None:
        return self.manual.beside(verb, request, state) or self._batches.beside(verb, request, state)

    def _reset(self) -> None:
        """Reset. Raises: CycleFailure when the watchdog has ended, and as `Actions.reset`."""
        if not self._is_watched():
            raise CycleFailure(Code.INTERNAL, "Nobody watches the nodes any more: end this cell and start it again.")
        self.actions.reset()

    def _turn(self) -> None:
        """On the machine's owner thread, several times a second: prove that a stop would be answered; see the hand."""
        self._publish_heartbeat()
        self.in_hand.look(self.machine.state)

    def _publish_heartbeat(self) -> None:
        if time.monotonic() - self._published_s >= TURN_S / 2:
            self._published_s = time.monotonic()
            with suppress(BusError):  # closing
                self._bus.publish(topics.HEARTBEAT, Heartbeat())

    # --- callbacks of the actions -------------------------------------------------------------------------------------

    def _publish(self, topic: Topic, message: Message | bytes) -> None:
        """Publish what a cycle says; whoever sees it may point into it at once."""
        self._pointed.hear(message)
        self.publisher.publish(topic, message)

    def _on_result(self, result: CycleResult) -> None:
        self._results[result.cycle_id] = result
        while len(self._results) > _KEPT_RESULTS:
            self._results.popitem(last=False)
        self._batches.count(result)

    def _on_fault(self, failure: CycleFailure) -> None:
        self.machine.fault(failure)

    def _post_stop(self, reason: str) -> None:
        self.machine.post("stop", CommandRequest(client_id=CELL_CLIENT), reason)


def _reaches(station: Station, robot: Robot) -> Callable[[Vector], bool]:
    """Return whether the arm can come to a place; always yes for an arm of which that takes long to find."""
    if station.robot is not None:
        return lambda place_m: True
    return lambda place_m: reaches(robot.arm, np.array(place_m))
