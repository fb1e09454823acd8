"""The owner of the machine: one thread processes commands and ends of actions one at a time, and changes the state.

An acting state runs an `Action` in a thread of its own; an action never decides the next state. Every run of an action
has a number: the end of a run that a stop left behind is not taken for the end of another, and nothing begins while
one still runs. `HoldState` knows whether the cell is held, and why; only this thread changes it.
"""

from __future__ import annotations

import itertools
import logging
import queue
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet

from bus.codes import Code
from bus.commands import CommandReply, CommandRequest
from bus.errors import CellError, CycleFailure, Refused
from bus.threads import OwnedThread, Role, report_defect
from cell.machine.hold_state import HoldState
from cell.machine.inbox import Act, Command, Done, Fault, Item, Run
from cell.machine.leases import CELL_CLIENT
from cell.machine.states import (
    BEGINNING,
    COMMANDS,
    ENDING,
    GOING_ON,
    NEXT,
    PAUSES,
    PAUSING,
    State,
    after_command,
    available,
)

_log = logging.getLogger(__name__)
_REMEMBERED_COMMANDS = 256
_STOPPING = (State.STOPPING, State.ABORTING)
_NOT_YET = GOING_ON | {State.STARTING}
"""States in which nothing can be held, and which a state that can be held follows."""
_OWN = CommandRequest(client_id=CELL_CLIENT)
TURN_S = 0.1
"""Longest time without a turn of the owner thread."""
_LOOK_S = 0.5

Action = Callable[[], None]
"""The action of an acting state. A `CycleFailure` or other `CellError` that it raises aborts the machine."""


class Machine:
    """States, commands and actions of one cell.

    Args:
        actions: each acting state's action.
        holding: whether the cell is held, and why.
        on_state: called by the owner thread at every change, with the state and the reason.
        on_accept: called by the owner thread with every command that the state allows, before the state changes; it
            returns the id of the cycle that the command begins, or "", and may raise Refused.
        on_beside: called by the owner thread with every command and the state; it returns the reply of one that needs
            no change of state, None for any other, and may raise Refused.
        on_turn: called by the owner thread at least every `TURN_S`; as long as it is called, commands are answered.
    """

    def __init__(
        self,
        actions: Mapping[State, Action],
        hold_state: HoldState,
        on_state: Callable[[State, str], None],
        on_accept: Callable[[str, CommandRequest], str],
        on_beside: Callable[[str, CommandRequest, State], CommandReply | None] = lambda verb, request, state: None,
        on_turn: Callable[[], None] = lambda: None,
    ) -> None:
        self._actions, self.hold_state = actions, hold_state
        self._on_state, self._on_accept, self._on_beside, self._on_turn = on_state, on_accept, on_beside, on_turn
        self._inbox: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._answered: dict[tuple[str, str, str], CommandReply] = {}
        self.state = State.STOPPED
        self._why = self._why_aborted = ""
        self._numbers = itertools.count(1)
        self._run = self._held = Run(0, State.STOPPED)  # the run of the state, and that of the held state
        self._ended_held: Done | None = None  # the end of the held state's action during the pause
        self._thread = OwnedThread(Role.MACHINE, self._own)
        self._ended = threading.Event()
        self._open: set[Run] = set()  # runs whose end was not yet processed; used by the owner thread
        self._runs_change = threading.Condition()
        self._running: set[Run] = set()  # runs under way; guarded by `_runs_change`

    def start(self) -> None:
        """Start the owner thread in Stopped: nothing moves before a command."""
        self._on_state(self.state, "")
        self._thread.start()

    def command(self, verb: str, request: CommandRequest) -> CommandReply:
        """Request a command, from any thread, and wait for the reply, which says whether it was accepted."""
        reply: Future[CommandReply] = Future()
        reason = f"command {verb!r} from {request.client_id or 'a client'}"
        self._inbox.put(Command(verb, request, reply, reason))
        while True:
            try:
                return reply.result(_LOOK_S)
            except NotYet:
                if self._ended.is_set() and not reply.done():
                    return self._refusal(CycleFailure(Code.INTERNAL, "The thread that owns the machine has ended."))

    def post(self, verb: str, request: CommandRequest, reason: str = "") -> None:
        """Request a command without waiting for the reply: for the owner thread itself, and for callbacks."""
        self._inbox.put(Command(verb, request, Future(), reason))

    def decide(self, act: Callable[[], None]) -> None:
        """Let the owner thread run ``act``, after the queued items; does not wait."""
        self._inbox.put(Act(act))

    def fault(self, failure: CycleFailure) -> None:
        """Report a failure outside any action (e.g. a lost node): all motion ends, and the machine aborts.

        A Stopped machine stays Stopped.
        """
        self._inbox.put(Fault(failure))  # queued before the action that the gate interrupts can end
        self.hold_state.gate.halt(failure)

    def defect(self, failure: CycleFailure) -> None:
        """Report a defect of the cell itself: as `fault`, but from every state."""
        self._inbox.put(Fault(failure, is_defect=True))
        self.hold_state.gate.halt(failure)

    def hold(self, reason: str) -> None:
        """Hold before the next motion begins. Called by the owner thread, in a state that can be held."""
        self.hold_state.close(reason)
        self.post("hold", _OWN, reason)

    def hold_soon(self, reason: str) -> None:
        """Hold as soon as the state allows it; a reset cannot be held and is stopped. Called by the owner thread."""
        if self.state in COMMANDS["hold"]:
            self.post("hold", _OWN, reason)
        elif self.state is State.RESETTING:
            self.post("stop", _OWN, reason)
        elif self.state in _NOT_YET:
            self.hold_state.reason = reason

    @property
    def is_owned(self) -> bool:
        """True when the owner thread answers commands, or will do so once started."""
        return not self._ended.is_set()

    def wait_no_action(self, timeout_s: float) -> bool:
        """Wait up to ``timeout_s`` until no action runs, except the stopping ones, which call this."""
        with self._runs_change:
            return self._runs_change.wait_for(lambda: all(run.state in _STOPPING for run in self._running), timeout_s)

    def close(self) -> None:
        """End the owner thread after the queued items."""
        self._inbox.put(None)
        self._thread.join()

    # --- the owner thread ---------------------------------------------------------------------------------------------

    def _own(self) -> None:
        try:
            while (item := self._next()) is not None:
                try:
                    self._take(item)
                except Exception as defect:  # noqa: BLE001 - without the owner thread the cell could not be stopped
                    self._survive(item, defect)
        finally:
            self._ended.set()

    def _next(self) -> Item | None:
        while True:
            try:
                self._on_turn()
            except Exception as defect:  # noqa: BLE001 - as above
                report_defect(str(Role.MACHINE), defect)
            try:
                return self._inbox.get(timeout=TURN_S)
            except queue.Empty:
                continue

    def _take(self, item: Item) -> None:
        if isinstance(item, Command):
            item.reply.set_result(self._decide(item))
        elif isinstance(item, Done):
            self._finish(item)
        elif isinstance(item, Act):
            item.act()
        elif self.state not in (State.ABORTING, State.ABORTED) and (item.is_defect or self.state is not State.STOPPED):
            self._enter(State.ABORTING, str(item.failure))

    def _survive(self, item: Item, defect: Exception) -> None:
        """Handle a defect while processing an item: its client gets a reply, and the machine aborts."""
        failure = CycleFailure(Code.INTERNAL, f"{type(defect).__name__}: {defect}.")
        report_defect(str(Role.MACHINE), defect)
        if isinstance(item, Command) and not item.reply.done():
            item.reply.set_result(self._refusal(failure))
        if self.state not in (State.ABORTING, State.ABORTED):
            self._enter(State.ABORTING, str(failure))

    def _refusal(self, error: CellError) -> CommandReply:
        return CommandReply(
            ok=False,
            state=self.state,
            code=error.code,
            reason=error.text,
            advice=error.advice,
            available=getattr(error, "available", ()) or available(self.state),
        )

    def _decide(self, command: Command) -> CommandReply:
        """Accept or refuse; a repeated command id of the same client gets the same reply without acting twice.

        Commands that stop present motion always act, whatever their id, because a client's counter may restart.
        """
        request = command.request
        key = (command.verb, request.client_id, request.command_id)
        is_known = request.command_id != "" and key in self._answered
        if is_known and not (command.verb in ENDING and command.verb in available(self.state)):
            return self._answered[key]
        try:
            reply = self._on_beside(command.verb, request, self.state)
            if reply is not None:
                return reply if command.verb in ENDING else self._remembered(key, reply)
            target = after_command(self.state, command.verb)
            self._require_quiet(command.verb, target)
            cycle_id = self._on_accept(command.verb, request)
        except CellError as refusal:
            return self._refusal(refusal)
        self.hold_state.accept(command.verb, command.reason, is_own=request.client_id == CELL_CLIENT)
        if target in PAUSING:
            self._held, self._ended_held = self._run, None
        self._enter(target, command.reason)
        job_id = (request.job.job_id or cycle_id) if cycle_id else ""
        reply = CommandReply(
            ok=True, state=self.state, available=available(self.state), cycle_id=cycle_id, job_id=job_id
        )
        return self._remembered(key, reply)

    def _remembered(self, key: tuple[str, str, str], reply: CommandReply) -> CommandReply:
        """The reply, also to the same command sent again; ``key``: verb, client and command id."""
        if key[2]:
            self._answered[key] = reply
            if len(self._answered) > _REMEMBERED_COMMANDS:
                self._answered.pop(next(iter(self._answered)))
        return reply

    def _require_quiet(self, verb: str, target: State) -> None:
        """Refuse to begin while a stopped action still runs. Raises: Refused."""
        if target in BEGINNING and self._open:
            still = ", ".join(sorted({run.state for run in self._open}))
            raise Refused(
                f"{verb!r} is not possible yet: what the cell did in {still} has not ended, though it was stopped.",
                "Wait for it. If it does not end, end this cell and start it again.",
                code="STILL_RUNNING",
            )

    def _finish(self, done: Done) -> None:
        self._open.discard(done.run)
        if done.run == self._held and self.state in PAUSES:
            self._finish_held(done)
        elif done.run != self._run:
            pass  # a stop or abort came first, whose own action continues
        elif done.run.state is State.ABORTING:
            if done.error is not None:
                _log.warning("while aborting: %s", done.error)
            self._enter(State.ABORTED, self._why_aborted)  # the original cause, not later errors
        elif done.error is not None:
            self._fail(done.error)
        elif done.run.state in GOING_ON:
            self._go_on()
        else:
            self._enter(NEXT[done.run.state], self._why if done.run.state in PAUSING else "")

    def _finish_held(self, done: Done) -> None:
        """Handle the end of the held action, whose last motion was just over: a success waits for the pause's end."""
        if done.error is None:
            self._ended_held = done
        else:
            self._fail(done.error)

    def _go_on(self) -> None:
        """Return to the held state, whose action still runs or has ended meanwhile."""
        self._run = self._held
        self._change(self._held.state, "")
        if self._ended_held is not None:
            self._finish(self._ended_held)

    def _fail(self, error: CellError) -> None:
        stopped = isinstance(error, CycleFailure) and error.failure is Code.STOPPED
        self._enter(State.STOPPING if stopped else State.ABORTING, str(error))

    def _change(self, state: State, reason: str) -> None:
        self.state, self._why = state, reason
        if state is State.ABORTING:
            self._why_aborted = reason
        try:
            self._on_state(state, reason)
        except Exception as defect:  # noqa: BLE001 - the state holds, published or not
            report_defect(str(Role.MACHINE), defect)
            if state not in (State.ABORTING, State.ABORTED):
                self.fault(CycleFailure(Code.INTERNAL, f"{type(defect).__name__}: {defect}."))
        if self.hold_state.is_due(state):
            self.post("hold", _OWN, self.hold_state.reason)

    def _enter(self, state: State, reason: str) -> None:
        if state in _STOPPING:
            self.hold_state.reason = ""
        run = self._run = Run(next(self._numbers), state)
        if state in self._actions:
            self._open.add(run)
            with self._runs_change:
                self._running.add(run)  # here and not in the thread: a stop may come before the thread runs
        self._change(state, reason)
        if state in self._actions:
            OwnedThread(Role.ACTION, lambda: self._work(run), of=str(state)).start()
        elif state in NEXT:
            self._inbox.put(Done(run, None))

    def _work(self, run: Run) -> None:
        error: CellError | None = CycleFailure(Code.INTERNAL, f"What {run.state} does ended without a word.")
        try:
            self._actions[run.state]()
            error = None
        except CellError as caught:
            error = caught
        except Exception as defect:  # noqa: BLE001 - a defect in an action must abort the machine, not leave it hanging
            _log.exception("defect in %s", run.state)
            error = CycleFailure(Code.INTERNAL, f"{type(defect).__name__}: {defect}.")
        finally:
            self._inbox.put(Done(run, error))  # before the run is over: no later end may overtake it
            with self._runs_change:
                self._running.discard(run)
                self._runs_change.notify_all()


def refuse(reply: CommandReply) -> None:
    """Raises: Refused when ``reply`` is a refusal."""
    if not reply.ok:
        raise Refused(reply.reason, reply.advice, code=reply.code, available=reply.available, state=reply.state)
