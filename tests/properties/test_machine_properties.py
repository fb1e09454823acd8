"""Whatever is commanded, ends or fails, in whatever order: the machine is where the standard's table says."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from bus.codes import Code
from bus.commands import CommandRequest
from bus.errors import CycleFailure
from cell.machine.hold_state import HoldState
from cell.machine.owner import Machine
from cell.machine.states import State

# ISA-TR88.00.02, written down a second time: command, from, to. Ours: `pick`, and a hold from Completing.
ALL = tuple(str(state) for state in State)
TABLE = {
    "reset": (("Stopped", "Complete"), "Resetting"),
    "start": (("Idle",), "Starting"),
    "pick": (("Idle",), "Starting"),
    "stop": (tuple(set(ALL) - {"Stopping", "Stopped", "Clearing", "Aborting", "Aborted"}), "Stopping"),
    "abort": (tuple(set(ALL) - {"Aborting", "Aborted"}), "Aborting"),
    "hold": (("Execute", "Completing"), "Holding"),
    "unhold": (("Held",), "Unholding"),
    "suspend": (("Execute",), "Suspending"),
    "unsuspend": (("Suspended",), "Unsuspending"),
    "clear": (("Aborted",), "Clearing"),
}
COMPLETE = {
    "Resetting": "Idle", "Starting": "Execute", "Execute": "Completing", "Completing": "Complete",
    "Holding": "Held", "Suspending": "Suspended", "Stopping": "Stopped", "Aborting": "Aborted", "Clearing": "Stopped",
}  # fmt: skip
PAUSES = ("Holding", "Held", "Unholding", "Suspending", "Suspended", "Unsuspending")
ACTING = (*COMPLETE, "Unholding", "Unsuspending")
STOPPING = ("Stopping", "Aborting")
FAILURE = CycleFailure(Code.ARM_REFLEX, "It touched something.")


class _Work:
    """What an acting state does here: wait until the test ends it."""

    def __init__(self) -> None:
        self.begun, self.end = threading.Event(), threading.Event()
        self.fails = False
        self.thread = threading.current_thread()  # until it runs

    def __call__(self) -> None:
        self.thread = threading.current_thread()
        self.begun.set()
        assert self.end.wait(60)
        if self.fails:
            raise FAILURE


class MachineMatchesItsTable(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.works: dict[str, _Work] = {}  # of the state now, and of the one that it pauses
        self.machine = Machine(
            {State(name): self._work_of(name) for name in ACTING},
            HoldState(),
            lambda state, reason: None,
            lambda verb, request: "",
        )
        self.machine.start()
        self.state = "Stopped"
        self.paused_from = ""
        self.ended_in_pause = False

    def _work_of(self, name: str) -> Callable[[], None]:
        def work() -> None:
            self.works[name]()
            if name in STOPPING:  # as in the cell: everything else is over before a stop is
                assert self.machine.wait_no_action(10)

        return work

    def _enter(self, state: str) -> list[_Work]:
        """The model's own step, before the machine's; gives what a stop must end after it."""
        over = list(self.works.values()) if state in STOPPING else []
        if over:
            self.works = {}
        self.state = state
        if state in ACTING:
            self.works[state] = _Work()
        return over

    def _settle(self, over: Sequence[_Work]) -> None:
        """Everything queued before has been acted on once this is answered, and the new work has begun.

        What a stop left behind is over, too: while one of its ends is not taken, nothing else may begin.
        """
        self.machine.command("settle", CommandRequest())
        for work in over:
            work.end.set()
        for work in over:
            work.thread.join(60)
        self.machine.command("settle", CommandRequest())
        if self.state in self.works:
            assert self.works[self.state].begun.wait(60)

    def _end(self, work: _Work, name: str, over: Sequence[_Work] = (), *, fails: bool = False) -> None:
        threads = [thread for thread in threading.enumerate() if thread.name == f"action-{name}"]
        work.fails = fails
        work.end.set()
        for thread in threads:
            thread.join(60)
        self._settle(over)

    @rule(verb=st.sampled_from(sorted(TABLE)))
    def command(self, verb: str) -> None:
        sources, target = TABLE[verb]
        if verb == "pick" and self.state == "Complete":
            target, sources = "Resetting", ("Complete",)
        before = self.state
        over: list[_Work] = []
        if before in sources:
            if verb in ("hold", "suspend"):
                self.paused_from, self.ended_in_pause = before, False
            over = self._enter(target)
        reply = self.machine.command(verb, CommandRequest())
        assert reply.ok == (before in sources), reply
        self._settle(over)
        if not reply.ok:
            assert (reply.code, reply.state) == ("WRONG_STATE", before) and reply.reason
            assert verb not in reply.available

    @precondition(lambda self: self.state == "Stopped")
    @rule(pause=st.sampled_from(["", "hold", "suspend"]))
    def a_cycle_begins(self, pause: str) -> None:
        """A short way to where most of the arrows are."""
        for verb in ("reset", "start"):
            self.command(verb)
            self.the_state_is_done()
        if pause:
            self.command(pause)

    @precondition(lambda self: self.state in ("Held", "Suspended"))
    @rule()
    def the_cycle_goes_on(self) -> None:
        self.command("unhold" if self.state == "Held" else "unsuspend")

    @precondition(lambda self: self.state in ACTING)
    @rule()
    def the_state_is_done(self) -> None:
        state, work = self.state, self.works.pop(self.state)
        if state in ("Unholding", "Unsuspending"):
            self.state = self.paused_from
            if self.ended_in_pause:
                self.ended_in_pause = False
                self._enter(COMPLETE[self.state])
        else:
            self._enter(COMPLETE[state])
        self._end(work, state)

    @precondition(lambda self: self.state in ACTING and self.state != "Aborting")
    @rule()
    def the_state_fails(self) -> None:
        state, work = self.state, self.works.pop(self.state)
        self._end(work, state, self._enter("Aborting"), fails=True)

    @precondition(lambda self: self.state in PAUSES and not self.ended_in_pause)
    @rule(fails=st.booleans())
    def what_was_paused_ends_by_itself(self, fails: bool) -> None:
        work = self.works.pop(self.paused_from)
        self.ended_in_pause = not fails
        self._end(work, self.paused_from, self._enter("Aborting") if fails else [], fails=fails)

    @rule()
    def a_node_dies(self) -> None:
        over = self._enter("Aborting") if self.state not in ("Stopped", "Aborting", "Aborted") else []
        self.machine.fault(FAILURE)
        self._settle(over)

    @invariant()
    def it_is_where_the_table_says(self) -> None:
        assert str(self.machine.state) == self.state

    def teardown(self) -> None:
        for work in list(self.works.values()):
            work.end.set()
        self.machine.close()


MachineMatchesItsTable.TestCase.settings = settings(max_examples=200, stateful_step_count=40, deadline=None)
TestMachine = MachineMatchesItsTable.TestCase
