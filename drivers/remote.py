"""Camera, Arm and Hand over the bus: the same protocols, served by a `drivers.node.node` in another process.

Every call raises bus errors too: NoReply, ReplyTimeout, TwoAnswers, BadPayload, and the node's own errors by type.
"""

from __future__ import annotations

import logging
from typing import TypeVar

from pydantic import ValidationError

from bus import topics
from bus.codes import ADVICE, Code
from bus.commands import HandGrasp, HandMove, Nothing, Presented, PresentRequest
from bus.errors import CellError, HandFault, NotConnected, StaleFrame
from bus.messages import ArmState, Frame, HandState, Motion
from bus.sensor_codec import frame_from_wire
from bus.session import Bus
from bus.trajectory import Trajectory
from config.schema import Station
from drivers.interface import Devices

_log = logging.getLogger(__name__)
AskT = TypeVar("AskT", HandMove, HandGrasp)
_MOTION_SLACK_S = 30.0
_DRAWING_S = 30.0
"""Least timeout of a capture in simulation, which renders, and first compiles shaders [s]."""
_LONGEST_HOLD_S = 24 * 3600.0


class _Remote:
    """Common base: a bus, a deadline, and the life cycle."""

    def __init__(self, bus: Bus, timeout_s: float) -> None:
        self._bus = bus
        self._timeout_s = timeout_s
        self._connected = False

    def connect(self) -> None:
        """Mark as connected; the node owns and opens the device."""
        self._connected = True

    def close(self) -> None:
        """Mark as not connected; the node keeps the device open."""
        self._connected = False

    def _link(self) -> Bus:
        if not self._connected:
            raise NotConnected(f"The {type(self).__name__} is not connected.", "Call connect() first.")
        return self._bus


class RemoteCamera(_Remote):
    """A camera served on the bus. No frame is given twice, whoever asked for it first: a test, a look, the page."""

    def __init__(self, bus: Bus, timeout_s: float) -> None:
        super().__init__(bus, timeout_s)
        self._given_ns = -1

    def capture(self) -> Frame:
        """Return one fresh frame, as `Camera.capture`.

        Raises:
            StaleFrame: the node sent the last frame again.
            BadPayload, BadFrame: as `frame_from_wire`.
        """
        sample = self._link().ask(topics.CAMERA_CAPTURE, Nothing(), timeout_s=self._timeout_s)
        frame = frame_from_wire({part.key: part.payload for part in sample})
        if frame.stamp_ns == self._given_ns:
            raise StaleFrame("The camera sent its last frame again.", ADVICE[Code.STALE_FRAME])
        self._given_ns = frame.stamp_ns
        return frame


class RemoteArm(_Remote):
    """An arm served on the bus; the trajectory is streamed at its node, never over the bus."""

    def state(self) -> ArmState:
        """Return the measured state, as `Arm.state`."""
        return self._link().request(topics.ARM_NOW, Nothing(), ArmState, timeout_s=self._timeout_s)

    def execute(self, trajectory: Trajectory) -> Motion:
        """Play the trajectory at the node; the query waits as long as a hold may last, a day.

        A lost node does not need that deadline: when its connection ends, so does the query (`bus.errors.NoReply`), and
        the daemon aborts when its liveliness token goes. `stop`, with a worker of its own, ends a hanging motion.
        """
        patience_s = 3.0 * trajectory.duration_s + _MOTION_SLACK_S + _LONGEST_HOLD_S
        return self._link().request(topics.ARM_EXECUTE, trajectory, Motion, timeout_s=patience_s)

    def stop(self) -> None:
        """Stop the node's arm, as `Arm.stop`; a failure is only logged."""
        try:
            self._bus.ask(topics.ARM_STOP, Nothing(), timeout_s=self._timeout_s)
        except CellError as error:  # a stop never raises; the caller confirms it by the measured velocity
            _log.error("arm stop was not answered: %s", error)

    def hold(self) -> None:
        """Hold the node's arm, as `Arm.hold`; a failure is only logged."""
        try:
            self._bus.ask(topics.ARM_HOLD, Nothing(), timeout_s=self._timeout_s)
        except CellError as error:  # see stop
            _log.error("arm hold was not answered: %s", error)

    def resume(self) -> None:
        """Continue the held motion, as `Arm.resume`."""
        self._link().ask(topics.ARM_RESUME, Nothing(), timeout_s=self._timeout_s)

    def recover(self) -> None:
        """Clear a reflex, as `Arm.recover`; waits up to 30 s."""
        self._link().ask(topics.ARM_RECOVER, Nothing(), timeout_s=_MOTION_SLACK_S)  # the node may have to reconnect


class RemoteHand(_Remote):
    """A hand served on the bus."""

    def state(self) -> HandState:
        """Return the measured state, as `Hand.state`."""
        return self._link().request(topics.HAND_NOW, Nothing(), HandState, timeout_s=self._timeout_s)

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Move to ``width_m``, as `Hand.move`. Raises: HandFault for a number that is not finite."""
        ask = _asked(HandMove, width_m=width_m, speed_m_s=speed_m_s)
        return self._link().request(topics.HAND_MOVE, ask, HandState, timeout_s=_MOTION_SLACK_S)

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Grasp with ``force_n``, as `Hand.grasp`. Raises: HandFault for a number that is not finite."""
        ask = _asked(HandGrasp, force_n=force_n, speed_m_s=speed_m_s)
        return self._link().request(topics.HAND_GRASP, ask, HandState, timeout_s=_MOTION_SLACK_S)

    def home(self) -> HandState:
        """Home, as `Hand.home`."""
        return self._link().request(topics.HAND_HOME, Nothing(), HandState, timeout_s=_MOTION_SLACK_S)

    def stop(self) -> None:
        """Stop the node's hand, as `Hand.stop`; a failure is only logged."""
        try:
            self._bus.ask(topics.HAND_STOP, Nothing(), timeout_s=self._timeout_s)
        except CellError as error:  # see RemoteArm.stop
            _log.error("hand stop was not answered: %s", error)


class RemotePresenter(_Remote):
    """The object presenter of the simulated cell."""

    def present(self, request: PresentRequest) -> Presented:
        """Put an object on the table, as `ObjectPresenter.present`."""
        return self._link().request(topics.SIM_PRESENT, request, Presented, timeout_s=_MOTION_SLACK_S)

    def truth(self) -> Presented:
        """Return the true poses, as `ObjectPresenter.truth`."""
        return self._link().request(topics.SIM_TRUTH, Nothing(), Presented, timeout_s=self._timeout_s)


def _asked(kind: type[AskT], **values: float) -> AskT:
    """Make the request. Raises: HandFault for a number that is not finite."""
    try:
        return kind(**values)
    except ValidationError as error:
        raise HandFault(f"A hand cannot be asked for {values}.", "Nothing moved.") from error


def remote_devices(bus: Bus, station: Station) -> Devices:
    """Return connected remote devices of the whole cell; with a presenter only where a node simulates."""
    timeout_s = station.bus.ask_timeout_s
    camera_s = max(timeout_s, _DRAWING_S) if station.simulated else timeout_s
    camera, arm, hand = RemoteCamera(bus, camera_s), RemoteArm(bus, timeout_s), RemoteHand(bus, timeout_s)
    presenter = RemotePresenter(bus, timeout_s) if station.simulated else None
    for device in (camera, arm, hand, presenter):
        if device is not None:
            device.connect()
    return Devices(camera, arm, hand, presenter)
