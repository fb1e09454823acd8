"""What the machine does in its acting states: self-check, begin, pick, complete, hold, unhold, stop, clear."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np

from bus import topics
from bus.codec import encode
from bus.codes import Code
from bus.errors import BusError, ConfigError, CycleFailure, DriverError, MotionRefused, RecordingError
from bus.messages import ArmMode, Attempt, CycleResult
from bus.session import Heard
from bus.topics import encoding_of
from cell.cycle import FAULTS, Cycle, Equipment, Say
from cell.cyclelog import CycleLog
from cell.feed import Feed
from cell.fingers import require_at
from cell.gate import Gate
from cell.retry import Retries
from cell.runinfo import attachments, run_info
from config.scene import placing_at
from config.schema import Station
from drivers.interface import Feeder
from logs.recorder import Recorder, Under, ensure_space, plain
from planning.motion import move
from planning.scene import Scene

_REST_RAD_S = 0.1
"""Below this the arm rests: the FR3's measured velocity chatters by up to 0.08 rad/s at standstill."""
_AT_CAPTURE_RAD = 1e-3
_LOOK_S = 0.01
_ENDING_S = 1.0
"""How long a motion may take to be over once its arm says that nothing is held."""

DoneT = TypeVar("DoneT")


def new_cycle_id() -> str:
    """The UTC time to the millisecond: unique in one cell, and sorted by age."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"[:-3]


class Works:
    """The works of one cell, each run in a thread of its own by the `Machine`; at most one cycle is open.

    Args:
        feeder: puts objects on the simulated table; None on hardware.
        nodes_alive: names of the nodes that are up.
        say, on_stage: publish a message; tell that a stage began.
        on_result: told every cycle's result, after its recording is closed.
        on_fault: told what ends the cycle from outside its stages, on any thread: its recording failed.
        under: of every recording's file (`logs.recorder.Recorder`).

    Attributes:
        gate: halted by whoever wants everything to stop, shut by a hold; every motion passes it.
        next, object: the attempt that begins next, and its object; None = a new one, the feeder's next.
        gave_up: why the cell should hold at the end of this pick, or "".
        log: the open cycle's record, or None.
        feed: what lies on the simulated table.
    """

    def __init__(
        self,
        equipment: Equipment,
        feeder: Feeder | None,
        nodes_alive: Callable[[], set[str]],
        say: Say,
        on_stage: Callable[[str], None],
        on_result: Callable[[CycleResult], None],
        on_fault: Callable[[CycleFailure], None] = lambda _: None,
        under: Under = plain,
    ) -> None:
        self._under = under
        self._equipment, self._nodes_alive = equipment, nodes_alive
        self._station = equipment.station
        self.feed = Feed(feeder, equipment.station)
        self._say, self._on_stage, self._on_result, self._on_fault = say, on_stage, on_result, on_fault
        self._number = -1  # of the pick, however often it is tried
        self._cycle: Cycle | None = None
        self.gate = Gate()
        self._retries = Retries(self._station.retry)
        self._retry: Attempt | None = None
        self.gave_up = ""
        self.next: Attempt | None = None
        self.object: str | None = None
        self.log: CycleLog | None = None

    @property
    def cycle_id(self) -> str:
        """The open cycle's id, or ""."""
        cycle = self._cycle
        return cycle.cycle_id if cycle is not None else ""

    def reset(self) -> None:
        """Self-check, then the arm to the capture pose with an open hand. Raises: CycleFailure or DriverError."""
        e = self._equipment
        missing = set(self._station.nodes) - self._nodes_alive()
        if missing:
            raise CycleFailure(Code.NODE_LOST, f"These nodes are not up: {', '.join(sorted(missing))}.")
        ensure_space(self._station.recording.folder, self._station.recording.min_free_mb)
        state = e.arm.state()
        if state.mode is not ArmMode.IDLE:
            raise CycleFailure(Code.ARM_REFLEX, f"The arm is in mode {state.mode.value!r}, not idle.")
        if not e.hand.state().is_homed:
            self._move(e.hand.home)
        self._to_capture_pose(state.q_rad)
        hand = self._station.hand
        require_at(self._move(lambda: e.hand.move(hand.max_width_m, hand.speed_m_s)), hand.max_width_m)
        age_s = (time.time_ns() - e.camera.capture().stamp_ns) / 1e9
        if age_s > self._station.camera.max_age_s:
            raise CycleFailure(Code.STALE_FRAME, f"The camera's newest frame is {age_s:.1f} s old.")

    def _move(self, motion: Callable[[], DoneT]) -> DoneT:
        with self.gate.motion() as may_begin:
            if may_begin:
                return motion()
        raise CycleFailure(Code.STOPPED, "Stopped while resetting.")

    def _to_capture_pose(self, q_rad: np.ndarray) -> None:
        home_q_rad = np.asarray(self._station.arm.capture_q_rad)
        if float(np.abs(q_rad - home_q_rad).max()) < _AT_CAPTURE_RAD:
            return
        way = move(Scene.of(self._equipment.robot, self._station), q_rad, home_q_rad)
        motion = self._move(lambda: self._equipment.arm.execute(way))
        if not motion.finished:
            raise CycleFailure(Code.STOPPED, "Stopped on the way to the capture pose.")

    def begin(self) -> None:
        """Open the cycle's record; in simulation, put an object on the table. Raises: CycleFailure, RecordingError."""
        ensure_space(self._station.recording.folder, self._station.recording.min_free_mb)
        attempt, self.next = self.next or Attempt(cycle_id=new_cycle_id()), None
        self._retry, self._number = None, self._number + (attempt.number == 0)
        cycle_id = attempt.cycle_id
        day = datetime.now(UTC).strftime("%Y-%m-%d")
        path = self._station.recording.folder / day / f"{cycle_id}.mcap"
        station = placing_at(self._station, self._number)
        log = self.log = CycleLog(
            lambda: self._recorder(path, station, cycle_id),
            path,
            station.recording.patience_s,
            on_failure=self._on_fault,
        )
        equipment = replace(self._equipment, station=station)
        self._cycle = Cycle(attempt, equipment, self._say, self._on_stage, self.log, self.gate)
        self._on_stage("")
        try:
            log.await_open()
        except CycleFailure as failure:
            raise self._cycle.fail(failure) from failure
        self._say(topics.ATTEMPT, attempt)
        self._name_object(self._cycle, lambda: self.feed.present(self._number, self.object, again=attempt.number > 0))

    def _recorder(self, path: Path, station: Station, cycle_id: str) -> Recorder:
        """Raises: RecordingError."""
        recorder = Recorder(path, metadata=run_info(station, cycle_id), clock=time.time_ns, under=self._under)
        try:
            for name, text in attachments(station).items():
                recorder.attach(name, "application/json", text.encode())
            recorder.flush()
        except RecordingError:
            recorder.abandon()
            raise
        return recorder

    def _name_object(self, cycle: Cycle, ask: Callable[[], str]) -> None:
        """What the feeder says of the cycle's object. Raises: CycleFailure, kept in the cycle."""
        try:
            cycle.object = ask()
        except (DriverError, BusError) as error:
            raise cycle.fail(error) from error
        except ConfigError as error:  # there is no such object
            raise cycle.fail(CycleFailure(Code.NO_OBJECT, str(error))) from error

    def pick(self) -> None:
        """The five stages. A pick that failed goes on to Completing; a fault of a device does not."""
        cycle = self._cycle
        assert cycle is not None
        try:
            cycle.run()
        except CycleFailure as failure:
            if failure.failure in FAULTS or failure.failure is Code.STOPPED:
                raise
        self._retry = self._retries.after(cycle.attempt, cycle.code, cycle.grasp, new_cycle_id())
        self.gave_up = self._retries.holds()

    def renew(self, attempt: Attempt | None = None) -> None:
        """Somebody commands anew: ``attempt`` begins next, and what failed before no longer counts."""
        self.next, self._retries, self.gave_up = attempt, Retries(self._station.retry), ""

    def complete(self) -> None:
        """Deliver, and close the record."""
        cycle = self._cycle
        assert cycle is not None
        cycle.deliver()
        self._name_object(cycle, lambda: self.feed.taken(cycle.object))
        self.next = self._retry
        self._finish(self._retry.cycle_id if self._retry is not None else "")

    def hold(self) -> None:
        """Hold what moves, and confirm by the measured velocity that the arm rests; a stop ends the wait.

        The fingers cannot be held: their motion is waited for. Raises: CycleFailure when the arm does not rest.
        """
        arm = self._equipment.arm
        patience_s = self._station.arm.rest_s
        give_up_s = time.monotonic() + patience_s
        at_rest = 0  # readings running
        while at_rest < 2 and not self.gate.halted:  # the first may be of a motion that was just on its way: hold again
            if time.monotonic() > give_up_s:
                raise CycleFailure(Code.INTERNAL, f"The cell still moves {patience_s:.0f} s after the hold.")
            arm.hold()
            is_moving, state = self.gate.is_moving, arm.state()
            held = not is_moving or state.mode is ArmMode.MOVE
            at_rest = at_rest + 1 if held and float(np.abs(state.dq_rad_s).max()) <= _REST_RAD_S else 0
            time.sleep(_LOOK_S)

    def unhold(self) -> None:
        """Let the held motion go on, and what waits at the gate begin. Raises: MotionRefused, BusError."""
        if self.gate.is_moving:
            try:
                self._equipment.arm.resume()
            except MotionRefused:  # the hold came at its very end: then it is over now
                if not self.gate.wait_still(_ENDING_S):
                    raise
        self.gate.let_go()

    def stop(self, is_quiet: Callable[[float], bool]) -> None:
        """Stop until ``is_quiet`` (no work runs), then confirm by the measured velocity that the arm rests."""
        self.gate.halt()
        arm, hand = self._equipment.arm, self._equipment.hand
        patience_s = self._station.arm.rest_s
        give_up_s = time.monotonic() + patience_s
        try:
            arm.stop()
            hand.stop()
            while not is_quiet(0.05):  # a motion may just have been on its way: stop again
                arm.stop()
                hand.stop()
                if time.monotonic() > give_up_s:
                    raise CycleFailure(Code.INTERNAL, f"The cycle still runs {patience_s:.0f} s after the stop.")
            while not (speed_rad_s := float(np.abs(arm.state().dq_rad_s).max())) <= _REST_RAD_S:  # nan is no rest
                if time.monotonic() > give_up_s:
                    raise CycleFailure(Code.INTERNAL, f"The arm still moves at {speed_rad_s:.2f} rad/s after the stop.")
                time.sleep(0.01)
        finally:
            if self._cycle is not None:
                self._cycle.interrupt()
            self._finish()

    def clear(self) -> None:
        self._equipment.arm.recover()

    def _finish(self, retried_as: str = "") -> None:
        """Close the cycle's record, if one is open, then say the result: whoever hears it finds the file.

        Raises: CycleFailure(RECORDING), after saying so as the result.
        """
        cycle, log = self._cycle, self.log
        if cycle is None or log is None:
            return
        result = cycle.result(retried_as)
        self._cycle = self.log = None
        failure: CycleFailure | None = None
        log.hear(Heard(topics.RESULT.key, encoding_of(CycleResult), encode(result)))
        try:
            log.close({"result": result.result, "code": result.code or "", "reason": result.reason})
        except CycleFailure as error:
            failure = error
            lost = {"result": "ABORTED", "code": error.failure, "reason": error.text}
            result = result.model_copy(update=lost)
        self._on_result(result)
        self._say(topics.RESULT, result)
        if failure is not None:
            raise failure
