"""Serves a driver's devices on the bus: one worker (thread) per device, and further ones for urgent queries.

While a motion runs, the cell's heartbeat must arrive: it comes from the thread that would answer a stop. When it falls
silent, the arm could not be stopped, so it brakes on its path by itself.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TypeVar

from bus import topics
from bus.codec import decode, process_in_words
from bus.commands import Event, HandGrasp, HandMove, Health, Nothing, PresentRequest
from bus.errors import BusError, CellError, DriverUnavailable
from bus.frozen import Message
from bus.lazy import LazyModule
from bus.messages import Motion
from bus.sample import Asked, Sample
from bus.sensor_codec import arm_state_to_wire, frame_to_wire
from bus.session import Bus
from bus.silence import Silence
from bus.topics import Topic, encoding_of
from bus.trajectory import Trajectory
from config.schema import Station
from drivers.interface import Arm, Camera, Devices, Hand, ObjectPresenter, Reporting
from drivers.node.guard import Guard, HandGuard
from drivers.node.loops import Loop

if TYPE_CHECKING:
    from bus.faulty_bus import Spoilable
    from drivers.node import fault_injection
else:
    fault_injection = LazyModule("drivers.node.fault_injection")  # only where faults are allowed

ARM_STATE_PERIOD_S = 0.01
HAND_STATE_PERIOD_S = 0.05
HEALTH_PERIOD_S = 1.0
_TELL_PERIOD_S = 0.2
_PULSE = "health"
"""The heartbeat: the loop that publishes the others' health; the health monitor notices its absence."""
_LISTEN_PERIOD_S = 0.05
_NAME_TIMEOUT_S = 1.0
_REST_S = 0.5
"""Longest wait for the arm to rest before a process with a defect ends all the same."""

AskT = TypeVar("AskT", bound=Message)


class Node:
    """Connects the devices, answers queries for them, and publishes their states until closed.

    Args:
        name: the node's name in the station file.
        bus: an open session; the caller keeps and closes it.
        devices: the devices to serve. Arm and hand are wrapped in their guards here, so that every motion from the bus
            is checked.
    """

    def __init__(self, name: str, bus: Bus, devices: Devices, station: Station) -> None:
        self._faults: dict[str, Spoilable] = {}
        if station.faults.allowed:
            devices, self._faults = fault_injection.faulty_devices(devices, station.faults)
        self._name, self._bus, self._devices, self._station = name, bus, devices, station
        self._arm = Guard(devices.arm, station) if devices.arm is not None else None
        self._started_s = time.monotonic()
        self._told_s = self._started_s - _TELL_PERIOD_S
        self._answered = self._failed = self._defects = 0
        self._last_fault = ""
        self._motions = 0  # running motions of the arm; guarded by the condition below
        self._motion_change = threading.Condition()
        self._cell = Silence(station.silence_s, _LISTEN_PERIOD_S, bus.clock.now_s)
        self._was_heard = False  # a cell that never sent a heartbeat cannot have fallen silent
        self._untold = ""  # why the arm braked by itself, kept until the cell is heard again
        self._loops: list[Loop] = []

    def open(self) -> None:
        """Connect every device or none, then answer queries and announce the node.

        Raises:
            DriverError: a device cannot be connected.
            DriverUnavailable: another node has this name.
            ReplyTimeout: nobody says in time who has it.
        """
        self._require_free()
        try:
            self._connect()
        except CellError:
            self._disconnect()
            raise
        if self._devices.camera is not None:
            self._serve_camera(self._devices.camera)
        if self._arm is not None:
            self._serve_arm(self._arm)
        if self._devices.hand is not None:
            self._serve_hand(HandGuard(self._devices.hand, self._station))
        if self._devices.presenter is not None:
            self._serve_presenter(self._devices.presenter)
        if self._station.faults.allowed:
            fault_injection.allow_faults(self._bus, self._faults, self._station.faults)
        self._every(_PULSE, HEALTH_PERIOD_S, self._publish_health)
        self._bus.answer(topics.NODE_NOW, lambda _payload, _asked: self._health(), worker="state", name=self._name)
        self._bus.announce(topics.NODE_ALIVE, name=self._name)
        self._require_alone()

    def _require_free(self) -> None:
        """Check that no other process serves this name. Raises: DriverUnavailable, naming that process."""
        if self._name in self._bus.alive(topics.NODE_ALIVE):
            raise self._taken(self._others())

    def _require_alone(self) -> None:
        """Check again after the announcement; of nodes that start at once at most one stays.

        Raises: DriverUnavailable; ReplyTimeout when nobody says in time who is there.

        The node answers queries before it announces itself, so the later one of two sees the other.
        """
        try:
            self._bus.alive(topics.NODE_ALIVE)
            others = self._others()
            if others:
                raise self._taken(others)
        except CellError:
            self._bus.withdraw(topics.NODE_ALIVE, name=self._name)
            self.close()
            raise

    def _others(self) -> dict[str, bytes]:
        """Return the other sessions that serve this name, and their health."""
        answers = self._bus.sessions(topics.NODE_NOW, timeout_s=_NAME_TIMEOUT_S, name=self._name)
        return {session: health for session, health in answers.items() if session != self._bus.source}

    def _taken(self, others: dict[str, bytes]) -> DriverUnavailable:
        who = " and ".join(map(process_in_words, others.values())) or "a process that does not answer"
        return DriverUnavailable(
            f"There is a node {self._name!r} already: {who}.",
            'End it first, or give this one a name of its own. A node with run = "here" is started by `cell start`.',
        )

    def halt(self) -> None:
        """Stop the arm, if this node has one, because no client can any more. Never raises."""
        if self._arm is not None:
            self._arm.stop()

    def end_by_defect(self, name: str, defect: BaseException) -> None:
        """Stop the arm and publish why: the thread ``name`` of this process ended unforeseen. Never raises."""
        self._defects += 1
        self._last_fault = f"DEFECT: {name} ended: {type(defect).__name__}: {defect}"
        self.halt()
        with suppress(BusError):
            text = f"The node {self._name!r} ends: its thread {name} met {type(defect).__name__}: {defect}."
            self._bus.publish(topics.EVENT, Event(code="INTERNAL", severity="error", text=text))
            self._publish_health()
        with self._motion_change:
            self._motion_change.wait_for(lambda: self._motions == 0, _REST_S)

    def close(self) -> None:
        """Stop the arm, end the loops, disconnect; idempotent."""
        if self._arm is not None:
            self._arm.stop()
        for loop in self._loops:
            loop.close()
        self._disconnect()

    def _connect(self) -> None:
        if self._arm is not None:
            self._arm.connect()
        if self._devices.hand is not None:
            self._devices.hand.connect()
        if self._devices.camera is not None:
            # The graphics context of a rendered camera belongs to the thread that will capture.
            self._bus.worker("camera").submit(self._devices.camera.connect).result()

    def _disconnect(self) -> None:
        if self._devices.camera is not None:
            self._bus.worker("camera").submit(self._devices.camera.close).result()
        for device in (self._devices.hand, self._arm):
            if device is not None:
                device.close()

    # --- answers ------------------------------------------------------------------------------------------------------

    def _answer(self, topic: Topic, ask_type: type[AskT], act: Callable[[AskT], Message | None], worker: str) -> None:
        def handle(payload: bytes, _: Asked) -> Message:
            try:
                answer = act(decode(ask_type, payload))
            except CellError as error:
                self._note(error)
                raise
            self._answered += 1
            return Nothing() if answer is None else answer

        self._bus.answer(topic, handle, worker=worker)

    def _serve_camera(self, camera: Camera) -> None:
        def capture(payload: bytes, _: Asked) -> list[Sample]:
            decode(Nothing, payload)
            try:
                parts = frame_to_wire(camera.capture())
            except CellError as error:
                self._note(error)
                raise
            self._answered += 1
            for topic in topics.FRAME_PARTS:
                self._bus.publish(topic, parts[topic.key])
            return [Sample(topic.key, encoding_of(topic.says), parts[topic.key]) for topic in topics.FRAME_PARTS]

        self._bus.answer(topics.CAMERA_CAPTURE, capture, worker="camera")

    def _serve_arm(self, arm: Arm) -> None:
        def execute(trajectory: Trajectory) -> Motion:
            with self._under_way():
                return arm.execute(trajectory)

        self._answer(topics.ARM_EXECUTE, Trajectory, execute, "arm")
        self._answer(topics.ARM_RECOVER, Nothing, lambda _: arm.recover(), "arm")
        self._answer(topics.ARM_STOP, Nothing, lambda _: arm.stop(), "arm-stop")
        self._answer(topics.ARM_HOLD, Nothing, lambda _: arm.hold(), "arm-hold")
        self._answer(topics.ARM_RESUME, Nothing, lambda _: arm.resume(), "arm-hold")
        self._answer(topics.ARM_NOW, Nothing, lambda _: arm.state(), "state")
        self._every(
            "arm.state",
            ARM_STATE_PERIOD_S,
            lambda: self._bus.publish(topics.ARM_STATE, arm_state_to_wire(arm.state())),
        )
        self._bus.subscribe(topics.HEARTBEAT.key, self._hear_cell)
        self._every("cell", _LISTEN_PERIOD_S, lambda: self._brake_if_alone(arm))

    @contextmanager
    def _under_way(self) -> Iterator[None]:
        """Count a motion of the arm while the block runs."""
        with self._motion_change:
            self._motions += 1
        try:
            yield
        finally:
            with self._motion_change:
                self._motions -= 1
                self._motion_change.notify_all()

    def _hear_cell(self, sample: Sample) -> None:
        if self._bus.cell in (None, sample.source) and (sample.is_sealed or self._bus.seal is None):
            self._cell.hear()
            self._was_heard = True

    def _brake_if_alone(self, arm: Arm) -> None:
        silent_s = self._cell.for_s()
        if silent_s <= self._station.silence_s:
            self._tell_why_it_braked()
        elif self._was_heard and self._motions > 0:
            self._was_heard = False  # brake once; armed again by the next heartbeat
            arm.stop()
            text = f"The cell has said nothing for {silent_s:.2f} s while the arm moved: the arm braked on its path."
            self._untold = self._last_fault = text + self._bus.clock.busy_note()

    def _tell_why_it_braked(self) -> None:
        """Publish why the arm braked, once the cell is there to receive it."""
        text, self._untold = self._untold, ""
        if text:
            advice = "Was its process frozen, or the machine too busy? After `cell reset` it goes on."
            self._bus.publish(topics.EVENT, Event(code="CELL_SILENT", severity="error", text=text, advice=advice))

    def _serve_hand(self, hand: Hand) -> None:
        self._answer(topics.HAND_MOVE, HandMove, lambda ask: hand.move(ask.width_m, ask.speed_m_s), "hand")
        self._answer(topics.HAND_GRASP, HandGrasp, lambda ask: hand.grasp(ask.force_n, ask.speed_m_s), "hand")
        self._answer(topics.HAND_HOME, Nothing, lambda _: hand.home(), "hand")
        self._answer(topics.HAND_STOP, Nothing, lambda _: hand.stop(), "hand-stop")
        self._answer(topics.HAND_NOW, Nothing, lambda _: hand.state(), "state")
        self._every("hand.state", HAND_STATE_PERIOD_S, lambda: self._bus.publish(topics.HAND_STATE, hand.state()))

    def _serve_presenter(self, presenter: ObjectPresenter) -> None:
        self._answer(topics.SIM_PRESENT, PresentRequest, presenter.present, "arm")
        self._answer(topics.SIM_TRUTH, Nothing, lambda _: presenter.truth(), "state")

    # --- publications -------------------------------------------------------------------------------------------------

    def _publish_health(self) -> None:
        self._bus.publish(topics.NODE_HEALTH, self._health(), name=self._name)

    def _health(self) -> Health:
        return Health(
            name=self._name,
            pid=os.getpid(),
            uptime_s=time.monotonic() - self._started_s,
            answered=self._answered,
            failed=self._failed,
            last_fault=self._last_fault,
            loops={loop.name: loop.health() for loop in self._loops if loop.name != _PULSE},
            readings=self._readings(),
            defects=self._defects,
        )

    def _readings(self) -> dict[str, float]:
        devices = {"camera": self._devices.camera, "arm": self._devices.arm, "hand": self._devices.hand}
        readings: dict[str, float] = {}
        for name, device in devices.items():
            if isinstance(device, Reporting):
                readings |= {f"{name}.{key}": value for key, value in device.readings().items()}
        return readings

    def _every(self, name: str, period_s: float, act: Callable[[], None]) -> None:
        self._loops.append(Loop(name, period_s, act, self._note, self.halt))

    def _note(self, error: CellError) -> None:
        """Count the error and publish the health soon, so that clients that miss a stream learn why."""
        self._last_fault = f"{error.code}: {error}"
        self._failed += 1
        if time.monotonic() - self._told_s > _TELL_PERIOD_S:
            self._told_s = time.monotonic()
            with suppress(BusError):  # the session is closed
                self._publish_health()
