"""The owner of the machine: one thread takes commands and ends of work, one at a time, and moves the states.

What an acting state does is a `Work`, run in a thread of its own; what it must not do is decide where to go next.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass

from bus.codes import Code
from bus.commands import CommandReply, CommandRequest
from bus.errors import CellError, CycleFailure, Refused
from cell.states import GOING_ON, NEXT, PAUSES, PAUSING, State, after_command, available

_log = logging.getLogger(__name__)
_REMEMBERED_COMMANDS = 256
_STOPPING = (State.STOPPING, State.ABORTING)

Work = Callable[[], None]
"""What an acting state does. A `CycleFailure` or other `CellError` it raises aborts the machine."""


@dataclass(frozen=True)
class _Command:
    verb: str
    request: CommandRequest
    reply: Future[CommandReply]
    reason: str


@dataclass(frozen=True)
class _Done:
    state: State
    error: CellError | None


@dataclass(frozen=True)
class _Fault:
    error: CellError


class Machine:
    """States, commands and works of one cell.

    Args:
        works: what each acting state does.
        on_state: called by the owner thread at every change, with the state and the reason.
        on_accept: called by the owner thread with every accepted command, before the state changes; returns the id of
            the cycle it begins, or "".
    """

    def __init__(
        self,
        works: Mapping[State, Work],
        on_state: Callable[[State, str], None],
        on_accept: Callable[[str, CommandRequest], str],
    ) -> None:
        self._works = works
        self._on_state = on_state
        self._on_accept = on_accept
        self._inbox: queue.SimpleQueue[_Command | _Done | _Fault | None] = queue.SimpleQueue()
        self._answered: dict[tuple[str, str, str], CommandReply] = {}
        self.state = State.STOPPED
        self._why = self._why_aborted = ""
        self._held_from = State.EXECUTE
        self._ended_held: _Done | None = None  # the held state's work, when it ended by itself meanwhile
        self._thread = threading.Thread(target=self._own, name="machine", daemon=True)
        self._works_change = threading.Condition()
        self._running = 0  # works other than the stopping ones; two while a held one waits and another holds it

    def start(self) -> None:
        """Begin in Stopped: nothing moves until somebody commands it."""
        self._on_state(self.state, "")
        self._thread.start()

    def command(self, verb: str, request: CommandRequest) -> CommandReply:
        """Ask for a command, from any thread; the answer says whether it was accepted."""
        reply: Future[CommandReply] = Future()
        reason = f"command {verb!r} from {request.client_id or 'a client'}"
        self._inbox.put(_Command(verb, request, reply, reason))
        return reply.result()

    def post(self, verb: str, request: CommandRequest, reason: str = "") -> None:
        """Ask for a command without waiting for the answer: for the owner thread itself, and for callbacks."""
        self._inbox.put(_Command(verb, request, Future(), reason))

    def fault(self, error: CellError) -> None:
        """Report that something failed outside any work (a node died): the machine aborts."""
        self._inbox.put(_Fault(error))

    def wait_quiet(self, timeout_s: float) -> bool:
        """Wait until no work other than the calling state's runs; used by the stopping works."""
        with self._works_change:
            return self._works_change.wait_for(lambda: self._running == 0, timeout_s)

    def close(self) -> None:
        """End the owner thread after what is queued."""
        self._inbox.put(None)
        if self._thread.is_alive():
            self._thread.join()

    # --- the owner thread ---------------------------------------------------------------------------------------------

    def _own(self) -> None:
        while (item := self._inbox.get()) is not None:
            if isinstance(item, _Command):
                item.reply.set_result(self._decide(item))
            elif isinstance(item, _Done):
                self._finish(item)
            elif self.state not in (State.ABORTING, State.ABORTED, State.STOPPED):
                self._enter(State.ABORTING, str(item.error))

    def _decide(self, command: _Command) -> CommandReply:
        """Accept or refuse; the same client's same command id gets the same answer without acting twice."""
        request = command.request
        key = (command.verb, request.client_id, request.command_id)
        if request.command_id and key in self._answered:
            return self._answered[key]
        try:
            target = after_command(self.state, command.verb)
            cycle_id = self._on_accept(command.verb, request)
        except CellError as refusal:
            return CommandReply(
                ok=False,
                state=self.state,
                code=refusal.code,
                reason=str(refusal),
                available=getattr(refusal, "available", ()) or available(self.state),
            )
        if target in PAUSING:
            self._held_from, self._ended_held = self.state, None
        self._enter(target, command.reason)
        reply = CommandReply(ok=True, state=self.state, available=available(self.state), cycle_id=cycle_id)
        if request.command_id:
            self._answered[key] = reply
            if len(self._answered) > _REMEMBERED_COMMANDS:
                self._answered.pop(next(iter(self._answered)))
        return reply

    def _finish(self, done: _Done) -> None:
        if done.state is self._held_from and self.state in PAUSES:
            self._finish_held(done)
        elif done.state is not self.state:
            pass  # a stop or abort came first; its own work goes on
        elif done.state is State.ABORTING:
            if done.error is not None:
                _log.warning("while aborting: %s", done.error)
            self._enter(State.ABORTED, self._why_aborted)  # the cause, not what else went wrong on the way
        elif done.error is not None:
            self._fail(done.error)
        elif done.state in GOING_ON:
            self._go_on()
        else:
            self._enter(NEXT[done.state], self._why if done.state in PAUSING else "")

    def _finish_held(self, done: _Done) -> None:
        """The held work ended by itself, its last motion was just over: its success waits until the pause is over."""
        if done.error is None:
            self._ended_held = done
        else:
            self._fail(done.error)

    def _go_on(self) -> None:
        """Back to the held state, whose work still runs, or ended meanwhile."""
        self._change(self._held_from, "")
        if self._ended_held is not None:
            self._finish(self._ended_held)

    def _fail(self, error: CellError) -> None:
        stopped = isinstance(error, CycleFailure) and error.failure is Code.STOPPED
        self._enter(State.STOPPING if stopped else State.ABORTING, str(error))

    def _change(self, state: State, reason: str) -> None:
        self.state, self._why = state, reason
        if state is State.ABORTING:
            self._why_aborted = reason
        self._on_state(state, reason)

    def _enter(self, state: State, reason: str) -> None:
        self._change(state, reason)
        if state in self._works:
            if state not in _STOPPING:
                self._count(1)  # here and not in the thread: a stop may come before that runs
            threading.Thread(target=self._work, args=(state,), name=str(state), daemon=True).start()
        elif state in NEXT:
            self._inbox.put(_Done(state, None))

    def _work(self, state: State) -> None:
        error: CellError | None = None
        try:
            self._works[state]()
        except CellError as caught:
            error = caught
        except Exception as defect:  # noqa: BLE001 - a defect in a work must abort the machine, not leave it hanging
            _log.exception("defect in %s", state)
            error = CycleFailure(Code.INTERNAL, f"{type(defect).__name__}: {defect}.")
        self._inbox.put(_Done(state, error))  # before the count: no later state's end may overtake it
        if state not in _STOPPING:
            self._count(-1)

    def _count(self, by: int) -> None:
        with self._works_change:
            self._running += by
            self._works_change.notify_all()


def refuse(reply: CommandReply) -> None:
    """Raises: Refused when ``reply`` is a refusal."""
    if not reply.ok:
        raise Refused(reply.reason, code=reply.code, available=reply.available)
