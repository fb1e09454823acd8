"""What the machine's owner thread decides beyond the table of states; the one owner of "is this cell held, and why?".

A command that is accepted opens or shuts the gate here; a lost lease holds what moves, stops what cannot be held, and
ends the picks that were to follow; after the last state of a cycle the next one of a ``start`` begins. All of it
happens on one thread, in the order in which it came: none of it is undone by something that was on its way.
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
from cell.machine.states import COMMANDS, GOING_ON, State
from config.schema import RetrySettings

_OWN = CommandRequest(client_id=CELL_CLIENT)
_NOT_YET = GOING_ON | {State.STARTING}
"""Nothing can be held in these, and something that can follows."""


class Control:
    """Every member but `lose_lease` and `count` is called by the machine's owner thread.

    Args:
        retry: of the station.
    """

    def __init__(self, actions: Actions, publisher: Publisher, retry: RetrySettings) -> None:
        self._actions, self._publisher, self._retry = actions, publisher, retry
        self._machine: Machine | None = None
        self._batch: Batch | None = None
        self._unattended = ""  # why what begins next is to be held at once
        self._is_start = False  # a start may hold after failures, a single pick ends

    def drive(self, machine: Machine) -> None:
        """From now on ``machine`` is the one to command."""
        self._machine = machine

    # --- commands -----------------------------------------------------------------------------------------------------

    def accept(self, verb: str, request: CommandRequest) -> str:
        """Called before an accepted command changes the state; says which cycle it begins. Raises: Refused."""
        own, gate = request.client_id == CELL_CLIENT, self._actions.gate
        if verb in ("stop", "abort"):
            self._batch, self._unattended = None, ""
            gate.halt()
        elif verb in ("hold", "suspend"):
            self._unattended = ""
            gate.hold()
        elif own:
            self._require_next()
        else:
            self._unattended = ""
            if verb in ("reset", "clear"):
                self._batch = None
                self._actions.restart_attempts()
                gate.clear()
            elif verb in ("start", "pick"):
                return self._begin(verb, request)
        return ""

    def _require_next(self) -> None:
        """For what the cell commands itself between two picks. Raises: Refused when no pick is to follow any more."""
        if self._batch is None or self._batch.is_over:
            raise Refused("No other pick is to follow.", code="BATCH_OVER")

    def _begin(self, verb: str, request: CommandRequest) -> str:
        """The picks of a ``start``, or the one of a ``pick``; the first one's cycle id. Raises: Refused."""
        self._actions.table.require_possible(request)
        self._is_start = verb == "start"
        self._batch = Batch(request if verb == "start" else CommandRequest(), self._retry)
        attempt = Attempt(cycle_id=new_cycle_id())
        self._actions.restart_attempts(attempt)
        self._actions.object = request.object
        self._actions.gate.clear()
        return attempt.cycle_id

    # --- states -------------------------------------------------------------------------------------------------------

    def enter(self, state: State, reason: str) -> None:
        """Say the new state, and do what it makes due."""
        self._publisher.publish_state(state, reason)
        if reason and state in (State.ABORTING, State.ABORTED):
            self._publisher.publish_event(state.upper(), "error", reason)
        if self._unattended and state in COMMANDS["hold"]:
            self._post("hold", self._unattended)
        if state is State.COMPLETING:
            self._hold_if_it_gave_up()
        self._go_on(state)

    def _go_on(self, state: State) -> None:
        """With the next cycle of a ``start``."""
        goes_on = self._batch is not None and not self._batch.is_over
        if state is State.COMPLETE and goes_on:
            self._post("reset")
        elif state is State.IDLE and goes_on:
            self._post("start")
        elif state in (State.STOPPING, State.ABORTING):
            self._batch = None

    def _hold_if_it_gave_up(self) -> None:
        """Before the delivery begins: after too many failures somebody must look first."""
        why, self._actions.hold_after_failures = self._actions.hold_after_failures, ""
        if why and self._is_start:
            self._publisher.publish_event("GAVE_UP", "error", why)
            self._actions.gate.hold()
            self._post("hold", why)

    # --- what happens beside the states -------------------------------------------------------------------------------

    def lose_lease(self, client_id: str, why: str) -> None:
        """Nobody attends the motion. Called on any thread; decided by the owner thread, in the state it is in then."""
        reason = f"The lease of {client_id!r} was lost ({why}): nobody attends the motion."
        self._drives.decide(lambda: self._hold_unattended(reason))

    def _hold_unattended(self, reason: str) -> None:
        self._batch = None  # no further cycle begins
        state = self._drives.state
        if state in COMMANDS["hold"]:
            self._post("hold", reason)
        elif state is State.RESETTING:
            self._post("stop", reason)
        elif state in _NOT_YET:
            self._unattended = reason

    def count(self, result: CycleResult) -> None:
        """A cycle's result, told by the work that ended it. Say so when the running ``start`` gives up."""
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

    def _post(self, verb: str, reason: str = "") -> None:
        self._drives.post(verb, _OWN, reason)
