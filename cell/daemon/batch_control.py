"""Controls the sequence of picks: a command begins a batch, its results end it; in between the cell commands itself.

A job that asks for it waits in the queue while the cell works. All of it runs on the machine's owner thread, in order
of arrival. `cell.machine.hold_state` decides whether the cell is held.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from bus.commands import CommandReply, CommandRequest
from bus.errors import Refused
from bus.messages import Attempt, CycleResult, Job
from cell.daemon.actions import Actions, new_cycle_id
from cell.daemon.batch import Batch
from cell.daemon.jobs import JobQueue, Ordered
from cell.daemon.publisher import Publisher
from cell.machine.leases import CELL_CLIENT
from cell.machine.owner import Machine
from cell.machine.states import ANSWERS, READY, State, available, require_answerable
from config.base import Vector
from config.job import capacity_of, place_of, require_possible, station_for
from config.schema import Station

_OWN = CommandRequest(client_id=CELL_CLIENT)
_MORE = "It was to pick more: start it again after this pick."
_NOT_READY = frozenset({State.STOPPED, State.STOPPING, State.ABORTED, State.ABORTING, State.CLEARING})
"""States in which no job can wait for its turn: what waited was dropped, and the cell must be made ready first."""


class BatchControl:
    """Controls the batch of one machine. All members but `lose_lease` and `count` are called by its owner thread.

    Args:
        reads_text: a model finds targets by any words.
        rest: brings a motion by hand to rest.
        resolved: gives a job with what it points at in a picture. It raises Refused.
        picture_px: gives width and height of the camera's pictures; None = not known yet.
        reaches: whether the arm can come to a place (x, y, z) [m] in ``base``; True where that takes long to find.
    """

    def __init__(
        self,
        actions: Actions,
        publisher: Publisher,
        station: Station,
        *,
        reads_text: bool = False,
        rest: Callable[[], None] = lambda: None,
        resolved: Callable[[Job], Job] = lambda job: job,
        picture_px: Callable[[], tuple[int, int] | None] = lambda: None,
        reaches: Callable[[Vector], bool] = lambda _: True,
    ) -> None:
        self._reaches = reaches
        self._rest, self._resolved, self._picture_px = rest, resolved, picture_px
        self._actions, self._publisher, self._station, self._reads_text = actions, publisher, station, reads_text
        self._machine: Machine | None = None
        self._queue = JobQueue(station.queue.max)
        self._batch: Batch | None = None
        self._ordered: Ordered | None = None  # of the batch
        self._is_start = False  # a start may hold after failures; a single pick ends

    def drive(self, machine: Machine) -> None:
        """Set the machine to command; called once, before any other member."""
        self._machine = machine

    @property
    def jobs(self) -> tuple[str, tuple[str, ...]]:
        """The id of the job under way, or "", and those of the waiting ones."""
        ordered = self._under_way
        return ordered.job.job_id if ordered is not None else "", self._queue.ids

    @property
    def asked_by(self) -> str:
        """The client that asked for the job under way, or ""."""
        ordered = self._under_way
        return ordered.request.client_id if ordered is not None else ""

    @property
    def _under_way(self) -> Ordered | None:
        return self._ordered if self._goes_on else None

    # --- commands -----------------------------------------------------------------------------------------------------

    def accept(self, verb: str, request: CommandRequest) -> str:
        """Process a command. Returns the id of the cycle that it begins, or "".

        Raises: Refused when the batch, the table or the station does not allow it.
        """
        if verb in ("stop", "abort"):
            self._batch = None
        elif request.client_id == CELL_CLIENT:
            self._require_next(verb)
        elif verb in ("reset", "clear"):
            self._batch = None
            if verb == "reset" and self._drives.state is State.STOPPED:  # stop and reset: somebody has emptied them
                self._actions.laid.clear()
            self._actions.restart_attempts()
        elif verb in ("start", "pick"):
            ordered = Ordered.of(verb, self._possible(request), new_cycle_id())
            self._begin(ordered)
            return ordered.cycle_id
        return ""

    def beside(self, verb: str, request: CommandRequest, state: State) -> CommandReply | None:
        """Process a command that changes no state: ``cancel``, an answer to a proposal, a job that waits while the cell
        works.

        Returns: its reply; None for any other command. Raises: Refused.
        """
        if verb == "cancel":
            self._cancel(request.job.job_id)
            return CommandReply(ok=True, state=state, available=available(state), job_id=request.job.job_id)
        for answer in ANSWERS:
            if verb == answer:
                require_answerable(verb, state)
                said = (request.proposal, request.client_id, request.reason)
                self._actions.approvals.answer(answer, *said, time.time_ns())
                return CommandReply(ok=True, state=state, available=available(state))
        is_next = self._ends(state)
        if verb in ("pick", "start") and (is_next or (request.job.queue and self._is_busy(state))):
            ordered = Ordered.of(verb, self._possible(request), new_cycle_id())
            position = self._queue.put_next(ordered) if is_next else self._queue.put(ordered)
            self._publisher.publish_jobs()
            return CommandReply(ok=True, state=state, available=available(state), cycle_id=ordered.cycle_id,
                                job_id=ordered.job.job_id, position=position)  # fmt: skip
        return None

    def _is_busy(self, state: State) -> bool:
        return state not in _NOT_READY and (self._goes_on or bool(self._queue.ids) or state not in READY)

    def _ends(self, state: State) -> bool:
        """Return whether the last result is said and only the state is behind: who has heard it may ask for more."""
        is_said = state is State.COMPLETING and not self._actions.cycle_id
        return is_said and not self._goes_on and not self._queue.ids

    @property
    def _goes_on(self) -> bool:
        return self._batch is not None and not self._batch.is_over

    def _possible(self, request: CommandRequest) -> CommandRequest:
        """The request with what it points at; refuse what table, station or place cannot do, and a known job.

        Raises: Refused.
        """
        self._require_unknown(request.job.job_id)
        self._actions.table.require_possible(request)
        picture_px = self._picture_px()
        require_possible(self._station, request.job, reads_text=self._reads_text, picture_px=picture_px)
        self._require_reached(request.job)
        full = self._why_full(request)
        if full:
            raise Refused(full, "Empty it, then stop and reset the cell: it counts anew then.", code="PLACE_FULL")
        return request.model_copy(update={"job": self._resolved(request.job)})

    def _require_unknown(self, job_id: str) -> None:
        """Raises: Refused (JOB_KNOWN) for the id of another job: `cancel` and who waits for it could not tell them."""
        under_way, waiting = self.jobs
        if job_id and job_id in (under_way, *waiting):
            where = "is under way" if job_id == under_way else "waits already"
            advice = "Wait for its result, or send this one with another job_id."
            raise Refused(f"A job {job_id!r} {where}.", advice, code="JOB_KNOWN")

    def _require_reached(self, job: Job) -> None:
        if job.place is None:
            return
        place_m = station_for(self._station, job, self._actions.laid[place_of(job)]).scene.place_m
        if not self._reaches(place_m):
            field = "place.name" if job.place.name is not None else "place.position_m"
            at = ", ".join(f"{value:.2f}" for value in place_m)
            raise Refused(
                f"{field}: the place ({at}) cannot be reached.",
                "Name a place nearer to the arm, or lower, and send the job again: docs/howto/place.md.",
                code="BAD_JOB",
            )

    def _why_full(self, request: CommandRequest) -> str:
        place = place_of(request.job)
        capacity = capacity_of(self._station, place)
        is_full = 0 < capacity <= self._actions.laid[place]
        return f"The place {place!r} is full: it takes {capacity}, and so many were laid there." if is_full else ""

    def _require_next(self, verb: str) -> None:
        """Check a command of the cell itself between two picks. Raises: Refused when no further pick follows."""
        if verb in ("reset", "start") and (self._batch is None or self._batch.is_over):
            raise Refused("No other pick is to follow.", code="BATCH_OVER")

    def _begin(self, ordered: Ordered) -> None:
        """Begin the picks of a ``start``, or the one of a ``pick``."""
        request = ordered.request
        self._ordered, self._is_start = ordered, ordered.verb == "start"
        self._batch = Batch(request if self._is_start else CommandRequest(), self._station.retry)
        self._actions.restart_attempts(
            Attempt(cycle_id=ordered.cycle_id, job=ordered.job, asked_by=request.client_id),
            request.object,
            leaves_failed=request.until_empty,
            withdrawal=ordered.withdrawal,
        )

    # --- the queue ----------------------------------------------------------------------------------------------------

    def _cancel(self, job_id: str) -> None:
        """Remove a waiting job, or withdraw the one under way before its grasp. Raises: Refused (NO_JOB, TOO_LATE)."""
        batch, ordered = self._batch, self._ordered
        if self._queue.remove(job_id):
            self._publisher.publish_jobs()
            return
        if batch is None or batch.is_over or ordered is None or ordered.job.job_id != job_id:
            waiting = ", ".join(filter(None, (self.jobs[0], *self._queue.ids))) or "none"
            raise Refused(f"No job {job_id!r} is under way or waits.", f"There are: {waiting}.", code="NO_JOB")
        is_in_time = ordered.withdrawal.cancel()
        if not is_in_time and not self._is_start:
            raise Refused(f"The grasp of {job_id!r} is under way.", "Wait for its result, or stop it.", code="TOO_LATE")
        if not is_in_time:
            batch.end("The job was cancelled: the pick under way is its last.")

    def _begin_next(self) -> None:
        """Begin the next waiting job that can still be done; one that cannot is dropped, with an event."""
        while (ordered := self._queue.take()) is not None:
            full = self._why_full(ordered.request)
            if not full:
                self._begin(ordered)
                return
            self._say_dropped((ordered.job.job_id,), full)

    def _drop(self, why: str) -> None:
        """End the batch, and drop all that wait."""
        self._batch = None
        self._say_dropped(self._queue.drop(), why)

    def _say_dropped(self, ids: tuple[str, ...], why: str) -> None:
        if ids:
            text = f"Dropped, not begun: {', '.join(ids)}. {why}"
            self._publisher.publish_event("JOBS_DROPPED", "warning", text, "Send them again when the cell is ready.")

    # --- states -------------------------------------------------------------------------------------------------------

    def enter(self, state: State, reason: str) -> None:
        """Publish the new state, and take the actions due in it."""
        if state in _NOT_READY:
            self._drop(f"The cell is {state}. {reason}".strip())
        elif state in READY and (self._batch is None or self._batch.is_over):
            self._begin_next()
        self._publisher.publish_state(state, reason)
        if reason and state in (State.ABORTING, State.ABORTED):
            self._publisher.publish_event(state.upper(), "error", reason)
        if state is State.COMPLETING:
            self._hold_after_failures()
        self._go_on(state)

    def _go_on(self, state: State) -> None:
        """Command the next cycle of a ``start``, or the next job, when the state is Complete or Idle."""
        if state is State.COMPLETE and self._goes_on:
            self._drives.post("reset", _OWN)
        elif state is State.IDLE and self._goes_on:
            self._drives.post("start", _OWN)

    def _hold_after_failures(self) -> None:
        """Hold before the delivery after too many failures, so that a person examines the cell first."""
        why = self._actions.take_hold_after_failures()
        if why and self._is_start:
            self._publisher.publish_event("GAVE_UP", "error", why)
            self._drives.hold(why)

    # --- beside the states --------------------------------------------------------------------------------------------

    def lose_lease(self, client_id: str, why: str) -> None:
        """End the batch and hold: no client attends the motion. Any thread may call it; the owner thread acts."""
        reason = f"The lease of {client_id!r} was lost ({why}): nobody attends the motion."
        self._drives.decide(lambda: self._hold_unattended(reason))

    def _hold_unattended(self, reason: str) -> None:
        self._rest()
        if self._batch is not None and self._batch.is_followed:
            reason = f"{reason} {_MORE}"
        self._drop(reason)  # so no further cycle begins
        if self._drives.state is State.COMPLETING and not self._actions.cycle_id:
            return  # its result is said, and nothing of it moves any more: a client may go as soon as it has heard it
        self._drives.hold_soon(reason)

    def count(self, result: CycleResult) -> None:
        """Count a cycle's result, on the thread of the action that ended it; publish an event when a batch gives up."""
        batch, ordered = self._batch, self._ordered
        if batch is None:
            return
        batch.hear(result)
        if ordered is not None and not result.retried_as and (full := self._why_full(ordered.request)):
            batch.end(full)
        if batch.gave_up:
            self._publisher.publish_event("GAVE_UP", "error", batch.reason)

    @property
    def _drives(self) -> Machine:
        assert self._machine is not None, "drive() comes first"
        return self._machine
