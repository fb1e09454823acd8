"""Controls the sequence of picks: a command begins a batch, its results end it; in between the cell commands itself.

All of it runs on the machine's owner thread, in order of arrival. `cell.machine.hold_state` decides whether the cell is
held.
"""

from __future__ import annotations

from bus.commands import CommandRequest
from bus.errors import Refused
from bus.messages import Attempt, CycleResult
from cell.daemon.actions import Actions, new_cycle_id
from cell.daemon.batch import Batch
from cell.daemon.publisher import Publisher
from cell.machine.leases import CELL_CLIENT
from cell.machine.owner import Machine
from cell.machine.states import State
from config.schema import RetrySettings

_OWN = CommandRequest(client_id=CELL_CLIENT)


class BatchControl:
    """Controls the batch of one machine. All members but `lose_lease` and `count` are called by its owner thread.

    Args:
        retry: of the station.
    """

    def __init__(self, actions: Actions, publisher: Publisher, retry: RetrySettings) -> None:
        self._actions, self._publisher, self._retry = actions, publisher, retry
        self._machine: Machine | None = None
        self._batch: Batch | None = None
        self._is_start = False  # a start may hold after failures; a single pick ends

    def drive(self, machine: Machine) -> None:
        """Set the machine to command; called once, before any other member."""
        self._machine = machine

    # --- commands -----------------------------------------------------------------------------------------------------

    def accept(self, verb: str, request: CommandRequest) -> str:
        """Process a command. Returns the id of the cycle that it begins, or "".

        Raises: Refused when the batch or the table does not allow it.
        """
        if verb in ("stop", "abort"):
            self._batch = None
        elif request.client_id == CELL_CLIENT:
            self._require_next(verb)
        elif verb in ("reset", "clear"):
            self._batch = None
            self._actions.restart_attempts()
        elif verb in ("start", "pick"):
            return self._begin(verb, request)
        return ""

    def _require_next(self, verb: str) -> None:
        """Check a command of the cell itself between two picks. Raises: Refused when no further pick follows."""
        if verb in ("reset", "start") and (self._batch is None or self._batch.is_over):
            raise Refused("No other pick is to follow.", code="BATCH_OVER")

    def _begin(self, verb: str, request: CommandRequest) -> str:
        """Begin the picks of a ``start``, or the one of a ``pick``; return the first cycle's id. Raises: Refused."""
        self._actions.table.require_possible(request)
        self._is_start = verb == "start"
        self._batch = Batch(request if verb == "start" else CommandRequest(), self._retry)
        attempt = Attempt(cycle_id=new_cycle_id())
        self._actions.restart_attempts(attempt, request.object, leaves_failed=request.until_empty)
        return attempt.cycle_id

    # --- states -------------------------------------------------------------------------------------------------------

    def enter(self, state: State, reason: str) -> None:
        """Publish the new state, and take the actions due in it."""
        self._publisher.publish_state(state, reason)
        if reason and state in (State.ABORTING, State.ABORTED):
            self._publisher.publish_event(state.upper(), "error", reason)
        if state is State.COMPLETING:
            self._hold_after_failures()
        self._go_on(state)

    def _go_on(self, state: State) -> None:
        """Command the next cycle of a ``start`` when the state is Complete or Idle."""
        goes_on = self._batch is not None and not self._batch.is_over
        if state is State.COMPLETE and goes_on:
            self._drives.post("reset", _OWN)
        elif state is State.IDLE and goes_on:
            self._drives.post("start", _OWN)
        elif state in (State.STOPPING, State.ABORTING):
            self._batch = None

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
        self._batch = None  # so no further cycle begins
        self._drives.hold_soon(reason)

    def count(self, result: CycleResult) -> None:
        """Count a cycle's result, on the thread of the action that ended it; publish an event when a batch gives up."""
        batch = self._batch
        if batch is None:
            return
        batch.hear(result)
        if batch.gave_up:
            self._publisher.publish_event("GAVE_UP", "error", batch.reason)

    @property
    def _drives(self) -> Machine:
        assert self._machine is not None, "drive() comes first"
        return self._machine
