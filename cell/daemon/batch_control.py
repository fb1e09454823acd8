"""Which pick follows: a command begins a batch of picks, its results end it, and between two the cell commands itself.

All of it happens on the machine's owner thread, in the order in which it came. Whether the cell is held is not decided
here: `cell.machine.holding`.
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
    """Every member but `lose_lease` and `count` is called by the machine's owner thread.

    Args:
        retry: of the station.
    """

    def __init__(self, actions: Actions, publisher: Publisher, retry: RetrySettings) -> None:
        self._actions, self._publisher, self._retry = actions, publisher, retry
        self._machine: Machine | None = None
        self._batch: Batch | None = None
        self._is_start = False  # a start may hold after failures, a single pick ends

    def drive(self, machine: Machine) -> None:
        """From now on ``machine`` is the one to command."""
        self._machine = machine

    # --- commands -----------------------------------------------------------------------------------------------------

    def accept(self, verb: str, request: CommandRequest) -> str:
        """The id of the cycle that a command begins, or "". Raises: Refused for what the batch or the table forbids."""
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
        """For what the cell commands itself between two picks. Raises: Refused when no pick is to follow any more."""
        if verb in ("reset", "start") and (self._batch is None or self._batch.is_over):
            raise Refused("No other pick is to follow.", code="BATCH_OVER")

    def _begin(self, verb: str, request: CommandRequest) -> str:
        """Begin the picks of a ``start``, or the one of a ``pick``: the first one's cycle id. Raises: Refused."""
        self._actions.table.require_possible(request)
        self._is_start = verb == "start"
        self._batch = Batch(request if verb == "start" else CommandRequest(), self._retry)
        attempt = Attempt(cycle_id=new_cycle_id())
        self._actions.restart_attempts(attempt, request.object)
        return attempt.cycle_id

    # --- states -------------------------------------------------------------------------------------------------------

    def enter(self, state: State, reason: str) -> None:
        """Publish the new state, and do what is due in it."""
        self._publisher.publish_state(state, reason)
        if reason and state in (State.ABORTING, State.ABORTED):
            self._publisher.publish_event(state.upper(), "error", reason)
        if state is State.COMPLETING:
            self._hold_after_failures()
        self._go_on(state)

    def _go_on(self, state: State) -> None:
        """With the next cycle of a ``start``."""
        goes_on = self._batch is not None and not self._batch.is_over
        if state is State.COMPLETE and goes_on:
            self._drives.post("reset", _OWN)
        elif state is State.IDLE and goes_on:
            self._drives.post("start", _OWN)
        elif state in (State.STOPPING, State.ABORTING):
            self._batch = None

    def _hold_after_failures(self) -> None:
        """Before the delivery begins: after too many failures a person must look first."""
        why = self._actions.take_hold_after_failures()
        if why and self._is_start:
            self._publisher.publish_event("GAVE_UP", "error", why)
            self._drives.hold(why)

    # --- beside the states --------------------------------------------------------------------------------------------

    def lose_lease(self, client_id: str, why: str) -> None:
        """End the batch and hold: nobody attends the motion. Any thread calls it, the owner thread decides."""
        reason = f"The lease of {client_id!r} was lost ({why}): nobody attends the motion."
        self._drives.decide(lambda: self._hold_unattended(reason))

    def _hold_unattended(self, reason: str) -> None:
        self._batch = None  # no further cycle begins
        self._drives.hold_soon(reason)

    def count(self, result: CycleResult) -> None:
        """Count a cycle's result, told by the action that ended it; publish an event when the ``start`` gives up."""
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
