"""The owner of the machine: one thread takes commands and ends of work, one at a time, and moves the states.

An acting state runs an `Action` in a thread of its own; an action never decides which state comes next. Every run of
an action has a number: the end of one that a stop left behind is not taken for the end of another, and nothing begins
while one still runs. Whether the cell is held, and why, is `Holding`'s; this thread alone changes it.
"""

from __future__ import annotations

import itertools
import logging
import queue
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet
from dataclasses import dataclass

from bus.codes import Code
from bus.commands import CommandReply, CommandRequest
from bus.errors import CellError, CycleFailure, Refused
from bus.threads import OwnedThread, Role, report_defect
from cell.machine.holding import Holding
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
"""Nothing can be held in these, and something that can follows."""
_OWN = CommandRequest(client_id=CELL_CLIENT)
TURN_S = 0.1
"""The owner does nothing for no longer than this."""
_LOOK_S = 0.5

Action = Callable[[], None]
"""What an acting state does. A `CycleFailure` or other `CellError` it raises aborts the machine."""


@dataclass(frozen=True)
class _Command:
    verb: str
    request: CommandRequest
    reply: Future[CommandReply]
    reason: str


@dataclass(frozen=True)
class _Run:
    """One run of an acting state's action."""

    number: int
    state: State


@dataclass(frozen=True)
class _Done:
    run: _Run
    error: CellError | None


@dataclass(frozen=True)
class _Fault:
    failure: CycleFailure
    is_defect: bool = False


@dataclass(frozen=True)
class _Act:
    """Something to be decided on the owner thread, between two commands."""

    act: Callable[[], None]


_Item = _Command | _Done | _Fault | _Act


class Machine:
    """States, commands and actions of one cell.

    Args:
        actions: each acting state's action.
        holding: whether the cell is held, and why.
        on_state: called by the owner thread at every change, with the state and the reason.
        on_accept: called by the owner thread with every command that the state allows, before the state changes; it
            returns the id of the cycle that the command begins, or "", and may raise Refused.
        on_turn: called by the owner thread at least every `TURN_S`: while it is, commands are answered.
    """

    def __init__(
        self,
        actions: Mapping[State, Action],
        holding: Holding,
        on_state: Callable[[State, str], None],
        on_accept: Callable[[str, CommandRequest], str],
        on_turn: Callable[[], None] = lambda: None,
    ) -> None:
        self._actions, self.holding = actions, holding
        self._on_state, self._on_accept, self._on_turn = on_state, on_accept, on_turn
        self._inbox: queue.SimpleQueue[_Item | None] = queue.SimpleQueue()
        self._answered: dict[tuple[str, str, str], CommandReply] = {}
        self.state = State.STOPPED
        self._why = self._why_aborted = ""
        self._numbers = itertools.count(1)
        self._run = self._held = _Run(0, State.STOPPED)  # the state's own, and that of the held state
        self._ended_held: _Done | None = None  # the held state's action, when it ended by itself meanwhile
        self._thread = OwnedThread(Role.MACHINE, self._own)
        self._ended = threading.Event()
        self._open: set[_Run] = set()  # runs whose end was not yet taken; the owner thread's
        self._runs_change = threading.Condition()
        self._running: set[_Run] = set()  # runs that are under way; guarded by it

    def start(self) -> None:
        """Begin in Stopped: nothing moves until somebody commands it."""
        self._on_state(self.state, "")
        self._thread.start()

    def command(self, verb: str, request: CommandRequest) -> CommandReply:
        """Ask for a command, from any thread; the answer says whether it was accepted."""
        reply: Future[CommandReply] = Future()
        reason = f"command {verb!r} from {request.client_id or 'a client'}"
        self._inbox.put(_Command(verb, request, reply, reason))
        while True:
            try:
                return reply.result(_LOOK_S)
            except NotYet:
                if self._ended.is_set() and not reply.done():
                    return self._refusal(CycleFailure(Code.INTERNAL, "The thread that owns the machine has ended."))

    def post(self, verb: str, request: CommandRequest, reason: str = "") -> None:
        """Ask for a command without waiting for the answer: for the owner thread itself, and for callbacks."""
        self._inbox.put(_Command(verb, request, Future(), reason))

    def decide(self, act: Callable[[], None]) -> None:
        """Have ``act`` done by the owner thread, after what is queued; does not wait."""
        self._inbox.put(_Act(act))

    def fault(self, failure: CycleFailure) -> None:
        """Report that something failed outside any action (a node died): every motion ends, and the machine aborts.

        A machine that is Stopped stays so.
        """
        self._inbox.put(_Fault(failure))  # before the action that the gate interrupts can end by itself
        self.holding.gate.halt(failure)

    def defect(self, failure: CycleFailure) -> None:
        """Report that the cell itself is not whole any more: as `fault`, from every state."""
        self._inbox.put(_Fault(failure, is_defect=True))
        self.holding.gate.halt(failure)

    def hold(self, reason: str) -> None:
        """Hold before the next motion begins. Called by the owner thread, in a state that can be held."""
        self.holding.close(reason)
        self.post("hold", _OWN, reason)

    def hold_soon(self, reason: str) -> None:
        """Hold as soon as the state allows it; a reset cannot be held and is stopped. Called by the owner thread."""
        if self.state in COMMANDS["hold"]:
            self.post("hold", _OWN, reason)
        elif self.state is State.RESETTING:
            self.post("stop", _OWN, reason)
        elif self.state in _NOT_YET:
            self.holding.reason = reason

    @property
    def is_owned(self) -> bool:
        """Whether its owner thread answers commands, or will once it is started."""
        return not self._ended.is_set()

    def wait_no_action(self, timeout_s: float) -> bool:
        """Wait until no action other than the stopping ones runs; these use it."""
        with self._runs_change:
            return self._runs_change.wait_for(lambda: all(run.state in _STOPPING for run in self._running), timeout_s)

    def close(self) -> None:
        """End the owner thread after what is queued."""
        self._inbox.put(None)
        self._thread.join()

    # --- the owner thread ---------------------------------------------------------------------------------------------

    def _own(self) -> None:
        try:
            while (item := self._next()) is not None:
                try:
                    self._take(item)
                except Exception as defect:  # noqa: BLE001 - without an owner nobody could stop the cell
                    self._survive(item, defect)
        finally:
            self._ended.set()

    def _next(self) -> _Item | None:
        while True:
            try:
                self._on_turn()
            except Exception as defect:  # noqa: BLE001 - as above
                report_defect(str(Role.MACHINE), defect)
            try:
                return self._inbox.get(timeout=TURN_S)
            except queue.Empty:
                continue

    def _take(self, item: _Item) -> None:
        if isinstance(item, _Command):
            item.reply.set_result(self._decide(item))
        elif isinstance(item, _Done):
            self._finish(item)
        elif isinstance(item, _Act):
            item.act()
        elif self.state not in (State.ABORTING, State.ABORTED) and (item.is_defect or self.state is not State.STOPPED):
            self._enter(State.ABORTING, str(item.failure))

    def _survive(self, item: _Item, defect: Exception) -> None:
        """A defect in what was just taken: its asker is answered, and the machine aborts."""
        failure = CycleFailure(Code.INTERNAL, f"{type(defect).__name__}: {defect}.")
        report_defect(str(Role.MACHINE), defect)
        if isinstance(item, _Command) and not item.reply.done():
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

    def _decide(self, command: _Command) -> CommandReply:
        """Accept or refuse; the same client's same command id gets the same answer without acting twice.

        But what stops something that moves stops it, whatever its id: counters begin anew.
        """
        request = command.request
        key = (command.verb, request.client_id, request.command_id)
        is_known = request.command_id != "" and key in self._answered
        if is_known and not (command.verb in ENDING and command.verb in available(self.state)):
            return self._answered[key]
        try:
            target = after_command(self.state, command.verb)
            self._require_quiet(command.verb, target)
            cycle_id = self._on_accept(command.verb, request)
        except CellError as refusal:
            return self._refusal(refusal)
        self.holding.accept(command.verb, command.reason, is_own=request.client_id == CELL_CLIENT)
        if target in PAUSING:
            self._held, self._ended_held = self._run, None
        self._enter(target, command.reason)
        reply = CommandReply(ok=True, state=self.state, available=available(self.state), cycle_id=cycle_id)
        if request.command_id:
            self._answered[key] = reply
            if len(self._answered) > _REMEMBERED_COMMANDS:
                self._answered.pop(next(iter(self._answered)))
        return reply

    def _require_quiet(self, verb: str, target: State) -> None:
        """Raises: Refused when something is to begin while an action that was stopped still runs."""
        if target in BEGINNING and self._open:
            still = ", ".join(sorted({run.state for run in self._open}))
            raise Refused(
                f"{verb!r} is not possible yet: what the cell did in {still} has not ended, though it was stopped.",
                "Wait for it. If it does not end, end this cell and start it again.",
                code="STILL_RUNNING",
            )

    def _finish(self, done: _Done) -> None:
        self._open.discard(done.run)
        if done.run == self._held and self.state in PAUSES:
            self._finish_held(done)
        elif done.run != self._run:
            pass  # a stop or abort came first; its own action goes on
        elif done.run.state is State.ABORTING:
            if done.error is not None:
                _log.warning("while aborting: %s", done.error)
            self._enter(State.ABORTED, self._why_aborted)  # the cause, not what else went wrong on the way
        elif done.error is not None:
            self._fail(done.error)
        elif done.run.state in GOING_ON:
            self._go_on()
        else:
            self._enter(NEXT[done.run.state], self._why if done.run.state in PAUSING else "")

    def _finish_held(self, done: _Done) -> None:
        """The held action ended by itself, its last motion was just over: its success waits until the pause is over."""
        if done.error is None:
            self._ended_held = done
        else:
            self._fail(done.error)

    def _go_on(self) -> None:
        """Back to the held state, whose action still runs, or ended meanwhile."""
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
        except Exception as defect:  # noqa: BLE001 - the state is what it is, whether it could be said or not
            report_defect(str(Role.MACHINE), defect)
            if state not in (State.ABORTING, State.ABORTED):
                self.fault(CycleFailure(Code.INTERNAL, f"{type(defect).__name__}: {defect}."))
        if self.holding.is_due(state):
            self.post("hold", _OWN, self.holding.reason)

    def _enter(self, state: State, reason: str) -> None:
        if state in _STOPPING:
            self.holding.reason = ""
        run = self._run = _Run(next(self._numbers), state)
        if state in self._actions:
            self._open.add(run)
            with self._runs_change:
                self._running.add(run)  # here and not in the thread: a stop may come before that runs
        self._change(state, reason)
        if state in self._actions:
            OwnedThread(Role.ACTION, lambda: self._work(run), of=str(state)).start()
        elif state in NEXT:
            self._inbox.put(_Done(run, None))

    def _work(self, run: _Run) -> None:
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
            self._inbox.put(_Done(run, error))  # before it is over: no later state's end may overtake it
            with self._runs_change:
                self._running.discard(run)
                self._runs_change.notify_all()


def refuse(reply: CommandReply) -> None:
    """Raises: Refused when ``reply`` is a refusal."""
    if not reply.ok:
        raise Refused(reply.reason, reply.advice, code=reply.code, available=reply.available, state=reply.state)
