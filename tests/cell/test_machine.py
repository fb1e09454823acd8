"""The machine's owner: commands are answered, works run, failures and stops lead where they must."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator

import pytest

from bus.codes import Code
from bus.commands import CommandRequest
from bus.errors import CellError, CycleFailure
from cell.machine.hold_state import HoldState
from cell.machine.owner import Machine
from cell.machine.states import State


class Bench:
    """A machine whose works are given by the test, and the states it went through."""

    def __init__(self) -> None:
        self.actions: dict[State, Callable[[], None]] = {}
        self.states: queue.SimpleQueue[tuple[State, str]] = queue.SimpleQueue()
        self.accepted: list[str] = []
        self.machine = Machine(
            self.actions, HoldState(), lambda state, reason: self.states.put((state, reason)), self._accept
        )

    def _accept(self, verb: str, _request: CommandRequest) -> str:
        self.accepted.append(verb)
        return "id" if verb == "pick" else ""

    def command(self, verb: str, command_id: str = "") -> bool:
        return self.machine.command(verb, CommandRequest(command_id=command_id)).ok

    def until(self, wanted: State) -> list[State]:
        """The states passed on the way to ``wanted``."""
        passed: list[State] = []
        while not passed or passed[-1] is not wanted:
            passed.append(self.states.get(timeout=60)[0])
        return passed


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    bench.machine.start()
    yield bench
    bench.machine.close()


def test_it_begins_stopped_and_moves_nothing(bench: Bench) -> None:
    assert bench.until(State.STOPPED) == [State.STOPPED]
    assert not bench.command("start")


def test_one_pick_goes_through_all_states(bench: Bench) -> None:
    bench.command("reset")
    bench.until(State.IDLE)
    reply = bench.machine.command("pick", CommandRequest())
    assert reply.ok and reply.cycle_id == "id"
    assert bench.until(State.COMPLETE) == [State.STARTING, State.EXECUTE, State.COMPLETING, State.COMPLETE]


def test_a_refusal_names_state_code_and_alternatives(bench: Bench) -> None:
    reply = bench.machine.command("pick", CommandRequest())
    assert (reply.ok, reply.state, reply.code) == (False, "Stopped", "WRONG_STATE")
    assert reply.available == ("reset", "abort") and "cell reset" in reply.advice


def test_the_same_command_id_acts_once(bench: Bench) -> None:
    assert bench.command("reset", "one") and bench.command("reset", "one")
    bench.until(State.IDLE)
    assert bench.accepted == ["reset"]


def test_a_stop_during_a_work_wins_over_its_end(bench: Bench) -> None:
    running, release = threading.Event(), threading.Event()

    def work() -> None:
        running.set()
        release.wait(60)

    def stop() -> None:
        release.set()
        assert bench.machine.wait_no_action(5)

    bench.actions.update({State.EXECUTE: work, State.STOPPING: stop})
    bench.command("reset")
    bench.until(State.IDLE)
    bench.command("start")
    assert running.wait(60)
    bench.command("stop")
    passed = bench.until(State.STOPPED)
    assert State.COMPLETING not in passed and passed[-2:] == [State.STOPPING, State.STOPPED]


def test_a_stop_right_after_a_start_waits_for_the_work_that_had_not_yet_begun(bench: Bench) -> None:
    ended: list[str] = []
    release = threading.Event()

    def begin() -> None:
        release.wait(60)
        ended.append("work")

    def stop() -> None:
        quiet_at_once = bench.machine.wait_no_action(0.05)
        release.set()
        assert not quiet_at_once and bench.machine.wait_no_action(5)
        ended.append("stop")

    bench.actions.update({State.STARTING: begin, State.STOPPING: stop})
    bench.command("reset")
    bench.until(State.IDLE)
    bench.command("start")
    bench.command("stop")
    assert bench.until(State.STOPPED)[-1] is State.STOPPED
    assert ended == ["work", "stop"]


@pytest.mark.parametrize(
    "error", [CycleFailure(Code.ARM_REFLEX, "Touched something."), CellError("Broken."), ZeroDivisionError("defect")]
)
def test_a_failing_work_aborts_with_its_reason(bench: Bench, error: Exception) -> None:
    def work() -> None:
        raise error

    bench.actions[State.RESETTING] = work
    bench.command("reset")
    reasons = {}
    while State.ABORTED not in reasons:
        state, reason = bench.states.get(timeout=60)
        reasons[state] = reason
    assert str(error).split(".")[0] in reasons[State.ABORTING]
    assert not bench.command("reset") and bench.command("clear")


def test_a_fault_from_outside_aborts(bench: Bench) -> None:
    bench.command("reset")
    bench.until(State.IDLE)
    bench.machine.fault(CycleFailure(Code.NODE_LOST, "The node is gone."))
    assert bench.until(State.ABORTED) == [State.ABORTING, State.ABORTED]


def test_an_abort_work_that_fails_still_ends_aborted(bench: Bench) -> None:
    def work() -> None:
        raise CellError("The arm does not answer.")

    bench.actions[State.ABORTING] = work
    bench.command("abort")
    assert bench.until(State.ABORTED)[-1] is State.ABORTED


# --- hold and unhold --------------------------------------------------------------------------------------------------


class HeldBench(Bench):
    """A machine in Held, from ``origin``; that state's work goes on until `end_work`, and raises ``error``."""

    def __init__(self, origin: State) -> None:
        super().__init__()
        self.origin = origin
        self.error: CellError | None = None
        self._end = threading.Event()
        self._resting = threading.Event()
        running = threading.Event()

        def work() -> None:
            running.set()
            assert self._end.wait(60)
            if self.error is not None:
                raise self.error

        def stop() -> None:
            self._resting.set()
            self._end.set()
            assert self.machine.wait_no_action(5)

        self.actions.update({origin: work, State.STOPPING: stop, State.ABORTING: stop})
        self.actions[State.HOLDING] = lambda: self._require(self._resting)
        self.machine.start()
        self.command("reset")
        self.until(State.IDLE)
        self.command("start")
        assert running.wait(60)
        self.until(origin)

    def _require(self, event: threading.Event) -> None:
        assert event.wait(60)

    def rest(self) -> None:
        """The arm rests: Holding may end."""
        self._resting.set()

    def end_work(self, error: CellError | None = None) -> None:
        """Let the held state's work end, and wait until the machine knows."""
        self.error = error
        self._end.set()
        for thread in threading.enumerate():
            if thread.name == self.origin:
                thread.join(60)
        self.machine.command("no such command", CommandRequest())  # answered after what was queued before

    def hold(self) -> None:
        assert self.command("hold")
        self.rest()
        assert self.until(State.HELD) == [State.HOLDING, State.HELD]


@pytest.fixture(params=[State.EXECUTE, State.COMPLETING])
def held(request: pytest.FixtureRequest) -> Iterator[HeldBench]:
    bench = HeldBench(request.param)
    yield bench
    bench.command("stop")
    bench.machine.close()


def _after(origin: State) -> list[State]:
    passed = [State.EXECUTE, State.COMPLETING, State.COMPLETE]
    return passed[passed.index(origin) :]


def test_a_hold_waits_and_unhold_goes_on_where_it_came_from(held: HeldBench) -> None:
    for _ in range(2):
        held.hold()
        assert held.command("unhold")
        assert held.until(held.origin) == [State.UNHOLDING, held.origin]
    held.end_work()
    assert held.until(State.COMPLETE) == _after(held.origin)[1:]


def test_a_hold_is_held_only_once_its_work_says_so(held: HeldBench) -> None:
    assert held.command("hold")
    reply = held.machine.command("unhold", CommandRequest())
    assert (reply.ok, reply.state, reply.code) == (False, "Holding", "WRONG_STATE")
    assert not held.command("hold")
    held.rest()
    held.until(State.HELD)


@pytest.mark.parametrize("when", ["holding", "held"])
def test_work_that_ends_during_a_hold_is_acted_on_at_unhold(held: HeldBench, when: str) -> None:
    assert held.command("hold")
    if when == "holding":
        held.end_work()
        held.rest()
    else:
        held.rest()
        held.until(State.HELD)
        held.end_work()
    if when == "holding":
        held.until(State.HELD)
    assert held.machine.state is State.HELD and held.states.empty()
    assert held.command("unhold")
    assert held.until(State.COMPLETE) == [State.UNHOLDING, *_after(held.origin)]


def test_work_that_ended_in_an_earlier_hold_counts_once() -> None:
    held = HeldBench(State.EXECUTE)
    completing = threading.Event()
    held.actions[State.COMPLETING] = lambda: held._require(completing)
    held.hold()
    held.end_work()
    assert held.command("unhold")
    held.until(State.COMPLETING)
    held.hold()
    assert held.command("unhold")
    assert held.until(State.COMPLETING) == [State.UNHOLDING, State.COMPLETING]
    completing.set()
    assert held.until(State.COMPLETE) == [State.COMPLETE]
    held.machine.close()


@pytest.mark.parametrize("when", ["holding", "held"])
@pytest.mark.parametrize("verb", ["stop", "abort"])
def test_a_stop_or_abort_ends_a_hold_and_waits_for_both_works(held: HeldBench, verb: str, when: str) -> None:
    if when == "held":
        held.hold()
    else:
        assert held.command("hold")
    assert held.command(verb)
    passing, final = {"stop": (State.STOPPING, State.STOPPED), "abort": (State.ABORTING, State.ABORTED)}[verb]
    assert held.until(final)[-2:] == [passing, final]
    assert not held.command("unhold")


def test_a_stop_while_unholding_wins() -> None:
    held = HeldBench(State.EXECUTE)
    going_on = threading.Event()
    held.actions[State.UNHOLDING] = lambda: held._require(going_on)
    held.hold()
    assert held.command("unhold") and held.command("stop")
    going_on.set()
    assert held.until(State.STOPPED) == [State.UNHOLDING, State.STOPPING, State.STOPPED]
    held.machine.close()


@pytest.mark.parametrize("when", ["holding", "held"])
def test_a_fault_during_a_hold_aborts(held: HeldBench, when: str) -> None:
    if when == "held":
        held.hold()
    else:
        assert held.command("hold")
    held.machine.fault(CycleFailure(Code.NODE_LOST, "The node is gone."))
    assert held.until(State.ABORTED)[-2:] == [State.ABORTING, State.ABORTED]


@pytest.mark.parametrize("code", [Code.ARM_REFLEX, Code.STOPPED])
def test_a_held_work_that_fails_does_not_wait_for_unhold(held: HeldBench, code: Code) -> None:
    held.hold()
    held.end_work(CycleFailure(code, "It ended."))
    final = State.STOPPED if code is Code.STOPPED else State.ABORTED
    assert held.until(final)[-1] is final


@pytest.mark.parametrize("state", [State.HOLDING, State.UNHOLDING])
def test_a_hold_or_unhold_that_fails_aborts(state: State) -> None:
    held = HeldBench(State.EXECUTE)

    def work() -> None:
        raise CycleFailure(Code.INTERNAL, "The arm does not rest.")

    held.actions[state] = work
    if state is State.UNHOLDING:
        held.hold()
    assert held.command({State.HOLDING: "hold", State.UNHOLDING: "unhold"}[state])
    assert held.until(State.ABORTED)[-2:] == [State.ABORTING, State.ABORTED]
    held.machine.close()
