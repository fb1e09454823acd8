"""The machine's owner: commands are answered, works run, failures and stops lead where they must."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator

import pytest

from bus.codes import Code
from bus.commands import CommandRequest
from bus.errors import CellError, CycleFailure
from cell.machine import Machine
from cell.states import State


class Bench:
    """A machine whose works are given by the test, and the states it went through."""

    def __init__(self) -> None:
        self.works: dict[State, Callable[[], None]] = {}
        self.states: queue.SimpleQueue[tuple[State, str]] = queue.SimpleQueue()
        self.accepted: list[str] = []
        self.machine = Machine(self.works, lambda state, reason: self.states.put((state, reason)), self._accept)

    def _accept(self, verb: str, _request: CommandRequest) -> str:
        self.accepted.append(verb)
        return "id" if verb == "pick" else ""

    def command(self, verb: str, command_id: str = "") -> bool:
        return self.machine.command(verb, CommandRequest(command_id=command_id)).ok

    def until(self, wanted: State) -> list[State]:
        """The states passed on the way to ``wanted``."""
        passed = []
        while not passed or passed[-1] is not wanted:
            passed.append(self.states.get(timeout=5)[0])
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
    assert reply.available == ("reset", "abort") and "cell reset" in reply.reason


def test_the_same_command_id_acts_once(bench: Bench) -> None:
    assert bench.command("reset", "one") and bench.command("reset", "one")
    bench.until(State.IDLE)
    assert bench.accepted == ["reset"]


def test_a_stop_during_a_work_wins_over_its_end(bench: Bench) -> None:
    running, release = threading.Event(), threading.Event()

    def work() -> None:
        running.set()
        release.wait(5)

    def stop() -> None:
        release.set()
        assert bench.machine.wait_quiet(5)

    bench.works.update({State.EXECUTE: work, State.STOPPING: stop})
    bench.command("reset")
    bench.until(State.IDLE)
    bench.command("start")
    assert running.wait(5)
    bench.command("stop")
    passed = bench.until(State.STOPPED)
    assert State.COMPLETING not in passed and passed[-2:] == [State.STOPPING, State.STOPPED]


def test_a_stop_right_after_a_start_waits_for_the_work_that_had_not_yet_begun(bench: Bench) -> None:
    ended: list[str] = []
    release = threading.Event()

    def begin() -> None:
        release.wait(5)
        ended.append("work")

    def stop() -> None:
        quiet_at_once = bench.machine.wait_quiet(0.05)
        release.set()
        assert not quiet_at_once and bench.machine.wait_quiet(5)
        ended.append("stop")

    bench.works.update({State.STARTING: begin, State.STOPPING: stop})
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

    bench.works[State.RESETTING] = work
    bench.command("reset")
    reasons = {}
    while State.ABORTED not in reasons:
        state, reason = bench.states.get(timeout=5)
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

    bench.works[State.ABORTING] = work
    bench.command("abort")
    assert bench.until(State.ABORTED)[-1] is State.ABORTED
