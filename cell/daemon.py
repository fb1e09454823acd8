"""The daemon: one machine, its works, and everything it says on the bus."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

import numpy as np

from bus import topics
from bus.codec import decode, encode
from bus.codes import Code
from bus.commands import CellState, CommandReply, CommandRequest, Event, PresentRequest
from bus.errors import BusError, CycleFailure, DriverError, Refused
from bus.frozen import Message
from bus.messages import ArmMode, CycleResult
from bus.session import Bus, Heard
from bus.topics import Topic, encoding_of
from cell.cycle import FAULTS, Cycle, Equipment
from cell.cyclelog import CycleLog
from cell.machine import Machine
from cell.runinfo import run_info
from cell.states import State, available
from config.schema import Station
from drivers.interface import Devices
from logs.recorder import ensure_space
from planning.robot import Robot
from planning.timing import move

_log = logging.getLogger(__name__)

Observer = Callable[[Topic, "Message | bytes"], None]

CELL_CLIENT = "cell"
"""``client_id`` of the commands the daemon gives itself between the cycles of one ``start``."""
_REST_RAD_S = 0.1
"""Below this the arm rests: the FR3's measured velocity chatters by up to 0.08 rad/s at standstill."""
_STOP_PATIENCE_S = 20.0
_AT_CAPTURE_RAD = 1e-3


class Daemon:
    """Owns the cell on the bus until closed.

    Args:
        station: its configuration.
        bus: the cell's own (listening) session; stays the caller's to close.
        devices: connected devices, usually `drivers.remote`.
        robot: the planning model.
        observer: told everything the daemon says, on the thread that says it; it may only enqueue.
    """

    def __init__(self, station: Station, bus: Bus, devices: Devices, robot: Robot, observer: Observer) -> None:
        camera, arm, hand = devices.camera, devices.arm, devices.hand
        if camera is None or arm is None or hand is None:
            raise DriverError("The cell needs a camera, an arm and a hand.", "Check `serves` in the station file.")
        self._station, self._bus, self._feeder, self._observer = station, bus, devices.feeder, observer
        self._equipment = Equipment(camera, arm, hand, robot, station)
        self._halt = threading.Event()
        self._numbers = itertools.count(1)
        self._remaining = 0
        self._object: str | None = None
        self._next_id = ""
        self._cycle: Cycle | None = None
        self._log: CycleLog | None = None
        self._said_state = CellState(state="", stage="", cycle_id="", since_ns=0, available=(), reason="")
        self.machine = Machine(
            {
                State.RESETTING: self._reset,
                State.STARTING: self._begin,
                State.EXECUTE: self._pick,
                State.COMPLETING: self._complete,
                State.STOPPING: self._stop,
                State.ABORTING: self._stop,
                State.CLEARING: self._clear,
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
        self._bus.watch_nodes(self._on_node)
        self._bus.answer(topics.STATE_NOW, lambda _payload, _fields: self._said_state, lane="state")
        self._bus.answer(topics.COMMAND, self._on_command, lane="command", verb="*")
        self.machine.start()

    def close(self) -> None:
        """Stop what runs, then end the machine; idempotent."""
        if "stop" in available(self.machine.state):
            self.command("stop", CommandRequest(client_id=CELL_CLIENT))
        give_up_s = time.monotonic() + _STOP_PATIENCE_S
        while self.machine.state in (State.STOPPING, State.ABORTING) and time.monotonic() < give_up_s:
            time.sleep(0.02)
        self.machine.close()

    def command(self, verb: str, request: CommandRequest) -> CommandReply:
        """A command from inside this process; the same as one over the bus."""
        return self.machine.command(verb, request)

    # --- what others say ----------------------------------------------------------------------------------------------

    def _on_command(self, payload: bytes, fields: Mapping[str, str]) -> Message:
        request = decode(CommandRequest, payload or b"{}")
        if request.client_id == CELL_CLIENT:
            raise Refused(f"The client id {CELL_CLIENT!r} is the cell's own.", "Send another.", code="BAD_CLIENT")
        return self.machine.command(fields["verb"], request)

    def _on_node(self, name: str, is_alive: bool) -> None:
        if not is_alive and name in self._station.nodes:
            self._halt.set()
            self.machine.fault(CycleFailure(Code.NODE_LOST, f"The node {name!r} is gone."))

    def _hear(self, heard: Heard) -> None:
        log = self._log
        if log is not None:
            log.hear(heard)

    # --- what the owner thread asks -----------------------------------------------------------------------------------

    def _on_accept(self, verb: str, request: CommandRequest) -> str:
        """Called before an accepted command changes the state; says which cycle it begins."""
        own = request.client_id == CELL_CLIENT
        if verb in ("stop", "abort"):
            self._remaining = 0
            self._halt.set()
        elif verb in ("reset", "clear") and not own:
            self._remaining = 0
            self._halt.clear()
        elif verb in ("start", "pick") and not own:
            self._remaining = request.cycles if verb == "start" else 1
            self._object = request.object
            self._next_id = self._new_cycle_id()
            self._halt.clear()
            return self._next_id
        return ""

    def _on_state(self, state: State, reason: str) -> None:
        """Say the new state, and go on with the next cycle of a ``start``."""
        self._say_state(state, reason=reason)
        if reason and state in (State.ABORTING, State.ABORTED):
            self._say(topics.EVENT, Event(code=state.upper(), severity="error", text=reason))
        own = CommandRequest(client_id=CELL_CLIENT)
        if state is State.COMPLETE and self._remaining > 0:
            self.machine.post("reset", own)
        elif state is State.IDLE and self._remaining > 0:
            self.machine.post("start", own)
        elif state in (State.STOPPING, State.ABORTING):
            self._remaining = 0

    # --- works of the acting states -----------------------------------------------------------------------------------

    def _reset(self) -> None:
        """Self-check, then the arm to the capture pose with an open hand. Raises: CycleFailure or DriverError."""
        e = self._equipment
        missing = set(self._station.nodes) - self._bus.nodes_alive()
        if missing:
            raise CycleFailure(Code.NODE_LOST, f"These nodes are not up: {', '.join(sorted(missing))}.")
        ensure_space(self._station.recording.folder, self._station.recording.min_free_mb)
        state = e.arm.state()
        if state.mode is not ArmMode.IDLE:
            raise CycleFailure(Code.ARM_REFLEX, f"The arm is in mode {state.mode.value!r}, not idle.")
        if not e.hand.state().is_homed:
            self._require_not_halted()
            e.hand.home()
        self._to_capture_pose(state.q_rad)
        self._require_not_halted()
        e.hand.move(self._station.hand.max_width_m, self._station.hand.speed_m_s)
        age_s = (time.time_ns() - e.camera.capture().stamp_ns) / 1e9
        if age_s > self._station.camera.max_age_s:
            raise CycleFailure(Code.STALE_FRAME, f"The camera's newest frame is {age_s:.1f} s old.")

    def _require_not_halted(self) -> None:
        if self._halt.is_set():
            raise CycleFailure(Code.STOPPED, "Stopped while resetting.")

    def _to_capture_pose(self, q_rad: np.ndarray) -> None:
        home_q_rad = np.asarray(self._station.arm.capture_q_rad)
        if float(np.abs(q_rad - home_q_rad).max()) < _AT_CAPTURE_RAD:
            return
        self._require_not_halted()
        motion = self._equipment.arm.execute(move(self._equipment.robot, q_rad, home_q_rad))
        if not motion.finished:
            raise CycleFailure(Code.STOPPED, "Stopped on the way to the capture pose.")

    def _begin(self) -> None:
        """Open the cycle's record; in simulation, put an object on the table."""
        cycle_id = self._next_id or self._new_cycle_id()
        self._next_id = ""
        number = next(self._numbers)
        day = datetime.now(UTC).strftime("%Y-%m-%d")
        path = self._station.recording.folder / day / f"{cycle_id}.mcap"
        metadata = run_info(self._station, cycle_id)
        self._log = CycleLog(path, self._station.model_dump_json(), metadata, time.time_ns)
        self._cycle = Cycle(cycle_id, self._equipment, self._say, self._on_stage, self._log, self._halt.is_set)
        self._say_state(State.STARTING)
        if self._feeder is not None:
            request = PresentRequest(object=self._object, cycle=number - 1, seed=self._station.sim.seed)
            self._cycle.object = self._feeder.present(request).object

    def _pick(self) -> None:
        """The five stages. A pick that failed goes on to Completing; a fault of a device does not."""
        assert self._cycle is not None
        try:
            self._cycle.run()
        except CycleFailure as failure:
            if failure.failure in FAULTS or failure.failure is Code.STOPPED:
                raise

    def _complete(self) -> None:
        """Deliver, and close the record."""
        assert self._cycle is not None
        self._cycle.deliver()
        self._finish()

    def _stop(self) -> None:
        """Stop until nothing runs, then confirm by the measured velocity that the arm rests."""
        self._halt.set()
        arm, hand = self._equipment.arm, self._equipment.hand
        give_up_s = time.monotonic() + _STOP_PATIENCE_S
        try:
            arm.stop()
            hand.stop()
            while not self.machine.wait_quiet(0.05):  # a motion may just have been on its way: stop again
                arm.stop()
                hand.stop()
                if time.monotonic() > give_up_s:
                    raise CycleFailure(Code.INTERNAL, f"The cycle still runs {_STOP_PATIENCE_S:.0f} s after the stop.")
            while (speed_rad_s := float(np.abs(arm.state().dq_rad_s).max())) > _REST_RAD_S:
                if time.monotonic() > give_up_s:
                    raise CycleFailure(Code.INTERNAL, f"The arm still moves at {speed_rad_s:.2f} rad/s after the stop.")
                time.sleep(0.01)
        finally:
            if self._cycle is not None:
                self._cycle.interrupt()
            self._finish()

    def _clear(self) -> None:
        self._equipment.arm.recover()

    def _finish(self) -> None:
        """Close the cycle's record, if one is open, then say the result: whoever hears it finds the file.

        Raises: CycleFailure(RECORDING), after saying so as the result.
        """
        cycle, log = self._cycle, self._log
        if cycle is None or log is None:
            return
        result = cycle.result()
        self._cycle = self._log = None
        failure: CycleFailure | None = None
        log.hear(Heard(topics.RESULT.key, encoding_of(CycleResult), encode(result)))
        try:
            log.close({"result": result.result, "code": result.code or "", "reason": result.reason})
        except CycleFailure as error:
            failure = error
            lost = {"result": "ABORTED", "code": error.failure, "reason": error.text}
            result = result.model_copy(update=lost)
        self._remaining = 0 if result.result in ("EMPTY", "ABORTED") else max(0, self._remaining - 1)
        self._say(topics.RESULT, result)
        if failure is not None:
            raise failure

    # --- what we say --------------------------------------------------------------------------------------------------

    def _say(self, topic: Topic, message: Message | bytes) -> None:
        try:
            self._bus.publish(topic, message)
        except BusError as error:  # closing: the observer below still hears it
            _log.warning("%s", error)
        self._observer(topic, message)

    def _on_stage(self, stage: str) -> None:
        self._say_state(self.machine.state, stage=stage)

    def _say_state(self, state: State, *, reason: str = "", stage: str = "") -> None:
        self._said_state = CellState(
            state=state,
            stage=stage,
            cycle_id=self._cycle.cycle_id if self._cycle is not None else "",
            since_ns=time.time_ns(),
            available=available(state),
            reason=reason,
        )
        self._say(topics.STATE, self._said_state)

    def _new_cycle_id(self) -> str:
        return f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"[:-3]
