"""The actions of the machine's acting states: self-check, begin, pick, complete, hold, unhold, stop, clear."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from bus import topics
from bus.arrays import Vector3
from bus.codec import encode
from bus.codes import Code
from bus.errors import BusError, ConfigError, CycleFailure, DriverError
from bus.messages import Attempt, CycleResult, Job
from bus.sample import Sample
from bus.topics import encoding_of
from cell.daemon.grip import Grip
from cell.daemon.resetting import reset
from cell.daemon.retry import Retries
from cell.daemon.runinfo import open_recorder
from cell.daemon.simulated_table import SimulatedTable
from cell.machine import standstill
from cell.machine.gate import Gate
from cell.pick.approving import Approvals
from cell.pick.cycle import Cycle
from cell.pick.equipment import Equipment
from cell.pick.record import CycleLog
from cell.pick.stages import FAULTS, Publish, Stages
from cell.pick.withdrawal import Withdrawal
from config.clock import clock_of
from config.job import place_of, station_for
from config.schema import Station
from drivers.interface import ObjectPresenter
from logs.mcap.recorder import Under, ensure_space, plain


def new_cycle_id() -> str:
    """A cycle id: the UTC time to the millisecond at which it is asked for, unique in one cell."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"[:-3]


def recording_path(folder: Path, cycle_id: str) -> Path:
    """The file of a cycle, in the folder of its id's day: there it is looked for, also when it waited past midnight."""
    return folder / f"{cycle_id[:4]}-{cycle_id[4:6]}-{cycle_id[6:8]}" / f"{cycle_id}.mcap"


class Actions:
    """The actions of one cell, each run in a thread of its own by the `Machine`; at most one cycle is open.

    Args:
        gate: every motion passes it (`cell.machine.hold_state`).
        presenter: puts objects on the simulated table; None on hardware.
        nodes_alive: returns the names of the nodes that are up.
        publish, on_stage: publish a message; called when a stage begins.
        on_result: called with every cycle's result, after its recording is closed.
        on_fault: called, on any thread, with what ends the cycle from outside its stages: its recording failed.
        under: wraps every recording's file (`logs.mcap.recorder.Recorder`).
        grip: knows whether the hand may hold something; None = nobody has told it anything.

    Attributes:
        log: the open cycle's record, or None.
        table: the objects on the simulated table.
        approvals: the planned motion that waits for a person, and its answer.
        laid: number of objects laid at each place since a stopped cell was last reset, by its name; "" is the tray.
    """

    def __init__(
        self,
        equipment: Equipment,
        gate: Gate,
        presenter: ObjectPresenter | None,
        nodes_alive: Callable[[], set[str]],
        publish: Publish,
        on_stage: Callable[[str], None],
        on_result: Callable[[CycleResult], None],
        on_fault: Callable[[CycleFailure], None] = lambda _: None,
        under: Under = plain,
        grip: Grip | None = None,
    ) -> None:
        self._under, self._gate = under, gate
        self._equipment, self._nodes_alive = equipment, nodes_alive
        self._station, self._clock = equipment.station, clock_of(equipment.station)
        self._grip = grip or Grip(self._station.hand, self._station.verify.min_width_m)
        self.table = SimulatedTable(presenter, equipment.station)
        self._publish, self._on_stage, self._on_result, self._on_fault = publish, on_stage, on_result, on_fault
        self._number = -1  # number of the pick, the same for all its attempts
        self._cycle: Cycle | None = None
        self._retries = Retries(self._station.retry)
        self._retry: Attempt | None = None
        self._hold_after_failures = ""
        self._next: Attempt | None = None
        self._failed_at: tuple[Vector3, ...] = ()
        self._leaves_failed = False
        self._object: str | None = None
        self._job, self._asked_by = Job(), ""
        self._withdrawal = Withdrawal()
        self.approvals = Approvals()
        self.laid: Counter[str] = Counter()
        self._goes_on = False
        self.log: CycleLog | None = None

    @property
    def cycle_id(self) -> str:
        """The open cycle's id, or ""."""
        cycle = self._cycle
        return cycle.cycle_id if cycle is not None else ""

    @property
    def asked_by(self) -> str:
        """The client that asked for the open cycle, or ""."""
        cycle = self._cycle
        return cycle.attempt.asked_by if cycle is not None else ""

    def reset(self) -> None:
        """Run the self-check, let go of what the hand may hold, then move the arm to the capture pose, the hand open.

        Raises: CycleFailure, DriverError.
        """
        goes_on, self._goes_on = self._goes_on, False
        reset(self._equipment, self._grip, self._gate, self._nodes_alive(), goes_on=goes_on)
        self.table.look()

    def begin(self) -> None:
        """Open the cycle's record; in simulation, put an object on the table.

        An object that cannot be presented fails this pick only: another may follow.

        Raises: CycleFailure, RecordingError.
        """
        ensure_space(self._station.recording.folder, self._station.recording.min_free_mb)
        attempt = self._next or self._another()
        self._next = None
        self._retry, self._number = None, self._number + (attempt.number == 0)
        self._withdrawal.begin_cycle()
        station = station_for(self._station, attempt.job, self._laid_before(attempt))
        log = self.log = self._record(attempt.cycle_id, station)
        equipment = replace(self._equipment, station=station)
        stages = Stages(attempt.cycle_id, self._publish, self._on_stage, log, self._gate, self._withdrawal)
        self._cycle = Cycle(attempt, equipment, stages, approvals=self.approvals)
        self._on_stage("")
        try:
            log.await_open()
        except CycleFailure as failure:
            raise self._cycle.stages.fail(failure) from failure
        self._publish(topics.ATTEMPT, attempt)
        is_pointed = attempt.job.target is not None and attempt.job.target.picture_ns is not None
        stays = attempt.number > 0 or is_pointed
        try:
            self._name_object(
                self._cycle,
                lambda: self.table.present(self._number, self._object, again=stays),
            )
        except CycleFailure as failure:
            if failure.failure is not Code.NO_OBJECT:
                raise

    def _another(self) -> Attempt:
        """The first attempt of a further pick, of the command that asked for the one before."""
        return Attempt(cycle_id=new_cycle_id(), failed_at=self._failed_at, job=self._job, asked_by=self._asked_by)

    def _laid_before(self, attempt: Attempt) -> int:
        """The number of the attempt's place in its pattern; picks into the station's own tray count, held or not."""
        place = place_of(attempt.job)
        return self.laid[place] if place else self._number

    def _record(self, cycle_id: str, station: Station) -> CycleLog:
        path = recording_path(station.recording.folder, cycle_id)
        return CycleLog(
            lambda: open_recorder(path, station, self._station, cycle_id, self._under),
            path,
            station.recording.patience_s,
            on_failure=self._on_fault,
            clock=self._clock,
        )

    def _name_object(self, cycle: Cycle, ask: Callable[[], str]) -> None:
        """Take the object's name from the presenter. Raises: CycleFailure, also kept in the cycle."""
        try:
            cycle.object = ask()
        except (DriverError, BusError) as error:
            raise cycle.stages.fail(error) from error
        except ConfigError as error:  # this object, or any object, cannot be presented
            raise cycle.stages.fail(CycleFailure(Code.NO_OBJECT, str(error))) from error

    def pick(self) -> None:
        """Run the five stages. A failed pick goes on to Completing. Raises: CycleFailure for a fault of a device."""
        cycle = self._cycle
        assert cycle is not None
        try:
            if cycle.stages.failure is None:  # else there is no object
                cycle.run()
        except CycleFailure as failure:
            if failure.failure in FAULTS or failure.failure is Code.STOPPED:
                raise
        self._retry = self._attempt_after(cycle)
        is_left = cycle.code not in (None, Code.MULTI_PICK)  # that place is empty
        if self._leaves_failed and self._retry is None and is_left and cycle.grasp is not None:
            self._failed_at = (*self._failed_at, cycle.grasp[:3, 3])
        self._hold_after_failures = self._retries.holds()

    def _attempt_after(self, cycle: Cycle) -> Attempt | None:
        """The attempt that follows a cycle; None for none, also when its job is withdrawn."""
        if self._withdrawal.due() is not None:
            return None
        failure, reason = cycle.stages.failure, cycle.reason
        obstacle_m = failure.obstacle_m if failure is not None else None
        return self._retries.after(cycle.attempt, cycle.code, cycle.grasp, new_cycle_id(), reason, obstacle_m)

    def restart_attempts(
        self,
        attempt: Attempt | None = None,
        object_name: str | None = None,
        *,
        leaves_failed: bool = False,
        withdrawal: Withdrawal | None = None,
    ) -> None:
        """Forget earlier failures, and what they left over, because a client gives a new command.

        Args:
            attempt: the one that begins next, whose job and client those after it have, too; None = a new one.
            object_name: its object on the simulated table; None = the presenter's next.
            leaves_failed: what fails for good is left where it is, and the next thing is picked.
            withdrawal: of the job.
        """
        self._next, self._object, self._failed_at = attempt, object_name, ()
        self._job, self._withdrawal = attempt.job if attempt is not None else Job(), withdrawal or Withdrawal()
        self._asked_by = attempt.asked_by if attempt is not None else ""
        self._leaves_failed = leaves_failed
        self._retries, self._hold_after_failures = Retries(self._station.retry), ""
        self._goes_on = False

    def take_hold_after_failures(self) -> str:
        """Return the reason to hold at the end of this pick, or ""; called once a pick."""
        why, self._hold_after_failures = self._hold_after_failures, ""
        return why

    def complete(self) -> None:
        """Deliver the object, and close the record. Raises: CycleFailure."""
        cycle = self._cycle
        assert cycle is not None
        cycle.deliver()
        if cycle.laid is not None:
            self.laid[cycle.laid.place] += 1
        self._name_object(cycle, lambda: self.table.taken(cycle.object))
        self._next = self._retry
        self._finish(self._retry.cycle_id if self._retry is not None else "")
        self._goes_on = True

    def hold(self) -> None:
        """Hold all motion until the arm rests. Raises: CycleFailure when it does not."""
        standstill.hold(self._equipment.arm, self._gate, self._station.arm.rest_s, self._clock)

    def unhold(self) -> None:
        """Resume the held motion. Raises: MotionRefused, BusError."""
        standstill.unhold(self._equipment.arm, self._gate, self._clock)

    def stop(self, no_action_running: Callable[[float], bool]) -> None:
        """Stop until no action runs and the arm rests; the open cycle ends. Raises: CycleFailure.

        Args:
            no_action_running: waits up to a time [s]; True when no other action runs.
        """
        try:
            arm, hand, rest_s = self._equipment.arm, self._equipment.hand, self._station.arm.rest_s
            standstill.stop(arm, hand, self._gate, no_action_running, rest_s, self._clock)
        finally:
            if self._cycle is not None:
                self._cycle.interrupt()
            self._finish()

    def clear(self) -> None:
        """Recover the arm after an abort. Raises: DriverError, BusError."""
        self._equipment.arm.recover()

    def halt_devices(self) -> None:
        """Stop all motion without waiting. Never raises."""
        self._gate.halt()
        self._equipment.arm.stop()
        self._equipment.hand.stop()

    def _finish(self, retried_as: str = "") -> None:
        """Close the cycle's record, if one is open, then publish the result, so that receivers find the file.

        Raises: CycleFailure(RECORDING), after publishing it as the result.
        """
        cycle, log = self._cycle, self.log
        if cycle is None or log is None:
            return
        result = cycle.result(retried_as)
        self._cycle = self.log = None
        failure: CycleFailure | None = None
        log.hear(Sample(topics.RESULT.key, encoding_of(CycleResult), encode(result)))
        try:
            log.close({"result": result.result, "code": result.code or "", "reason": result.reason})
        except CycleFailure as error:
            failure = error
            lost = {"result": "ABORTED", "code": error.failure, "reason": error.text}
            result = result.model_copy(update=lost)
        self._on_result(result)
        self._publish(topics.RESULT, result)
        if failure is not None:
            raise failure
