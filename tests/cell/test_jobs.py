"""Jobs: they wait while the cell works, in order; they are cancelled, late, dropped; a full place takes no more."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from bus.codes import Code
from bus.commands import CommandReply
from bus.errors import CycleFailure
from bus.messages import Attempt, Job, Place, Target
from cell.daemon.retry import Retries
from cell.machine.states import State
from cell.pick.withdrawal import Withdrawal
from config.pick import RetrySettings
from tests.cell.bench import OPERATOR, Bench

PLACES = 'scene.places=[{name="left", position_m=[0.4, 0.45, 0.15], capacity=1}]'


@contextmanager
def _ready(*options: str) -> Iterator[Bench]:
    bench = Bench(lambda verb: None, *options)
    bench.machine.command("reset", OPERATOR)
    assert bench.settle() is State.IDLE
    yield bench
    bench.actions.goes_on.set()
    bench.close()


def _send(bench: Bench, verb: str, job: Job, cycles: int = 1) -> CommandReply:
    return bench.machine.command(verb, OPERATOR.model_copy(update={"job": job, "cycles": cycles}))


def _busy(bench: Bench, job_id: str = "first", cycles: int = 1) -> CommandReply:
    """Begin a job whose motion is under way, and does not end."""
    bench.actions.goes_on.clear()
    reply = _send(bench, "start", Job(job_id=job_id), cycles)
    bench.await_motion()
    return reply


def test_a_pick_that_comes_to_the_gate_when_it_is_shut_waits_there_and_that_is_settled() -> None:
    with _ready() as bench:
        comes = threading.Event()

        def late() -> None:
            assert comes.wait(60)
            bench.actions.move()

        bench.actions.pick = late
        _send(bench, "start", Job(job_id="first"))
        bench.batches.lose_lease("op", "its token is gone")
        bench.await_state(State.HELD)
        comes.set()
        assert bench.settle() is State.HELD


# --- the queue --------------------------------------------------------------------------------------------------------


def test_jobs_wait_their_turn_and_begin_in_order() -> None:
    with _ready() as bench:
        assert _busy(bench).job_id == "first"
        replies = [_send(bench, "pick", Job(job_id=name, queue=True)) for name in ("second", "third")]
        assert [(reply.ok, reply.position) for reply in replies] == [(True, 1), (True, 2)]
        assert [reply.job_id for reply in replies] == ["second", "third"]
        assert bench.batches.jobs == ("first", ("second", "third"))
        bench.actions.goes_on.set()
        assert bench.settle() is State.COMPLETE
        assert bench.actions.begun == ["first", "second", "third"]
        assert not any(bench.batches.jobs)


def test_a_job_that_does_not_ask_to_wait_is_refused_while_the_cell_works() -> None:
    with _ready() as bench:
        _busy(bench)
        reply = _send(bench, "pick", Job())
        assert (reply.ok, reply.code) == (False, "WRONG_STATE")


def test_a_job_begins_at_once_when_the_cell_rests() -> None:
    with _ready() as bench:
        reply = _send(bench, "pick", Job(queue=True))
        assert (reply.ok, reply.position) == (True, 0)
        assert reply.job_id == reply.cycle_id, "a job without a name has that of its cycle"


def test_a_full_queue_refuses() -> None:
    with _ready("queue.max=1") as bench:
        _busy(bench)
        assert _send(bench, "pick", Job(job_id="a", queue=True)).ok
        assert _send(bench, "pick", Job(job_id="b", queue=True)).code == "QUEUE_FULL"


@pytest.mark.parametrize(("job_id", "says"), [("first", "is under way"), ("second", "waits already")])
def test_a_job_of_the_name_of_one_that_waits_or_is_under_way_is_refused(job_id: str, says: str) -> None:
    with _ready("queue.max=1") as bench:
        _busy(bench)
        assert _send(bench, "pick", Job(job_id="second", queue=True)).ok
        refused = _send(bench, "pick", Job(job_id=job_id, queue=True))
        assert (refused.ok, refused.code) == (False, "JOB_KNOWN")
        assert says in refused.reason and "another job_id" in refused.advice
        assert bench.batches.jobs == ("first", ("second",))
        bench.actions.goes_on.set()
        assert bench.settle() is State.COMPLETE
        assert _send(bench, "pick", Job(job_id=job_id)).ok, "it is over, and its name is free again"
        bench.settle()


def test_the_same_command_sent_again_has_the_reply_of_its_job_and_is_no_second_one() -> None:
    with _ready() as bench:
        _busy(bench)
        job = Job(job_id="second", queue=True)
        first, again = (
            bench.machine.command("pick", OPERATOR.model_copy(update={"job": job, "command_id": "7"})) for _ in range(2)
        )
        assert first.ok and again == first and bench.batches.jobs == ("first", ("second",))


@pytest.mark.parametrize("end", ["stop", "abort", "lease"])
def test_what_ends_the_motion_drops_what_waits_and_says_so(end: str) -> None:
    with _ready() as bench:
        _busy(bench)
        _send(bench, "pick", Job(job_id="second", queue=True))
        if end == "lease":
            bench.batches.lose_lease("op", "its token is gone")
        else:
            bench.machine.command(end, OPERATOR)
        bench.actions.goes_on.set()
        bench.settle()
        assert bench.batches.jobs[1] == ()
        assert any("JOBS_DROPPED" in event and "second" in event for event in bench.publisher.events)
        assert bench.actions.begun == ["first"]


@pytest.mark.parametrize(("cycles", "follow"), [(3, True), (1, False)])
def test_a_start_whose_client_is_gone_says_that_no_further_pick_of_it_begins(cycles: int, follow: bool) -> None:
    with _ready() as bench:
        _busy(bench, cycles=cycles)
        assert bench.batches.asked_by == "op"
        bench.batches.lose_lease("op", "its token is gone")
        bench.actions.goes_on.set()
        bench.settle()
        said = any("It was to pick more: start it again" in reason for _, reason in bench.publisher.states)
        assert (bench.actions.begun, said) == (["first"], follow)


def test_nothing_waits_while_the_cell_is_stopped() -> None:
    bench = Bench()
    assert _send(bench, "pick", Job(queue=True)).code == "WRONG_STATE"
    bench.close()


# --- cancel -----------------------------------------------------------------------------------------------------------


def test_a_waiting_job_is_cancelled_and_the_others_stay() -> None:
    with _ready() as bench:
        _busy(bench)
        for name in ("second", "third"):
            _send(bench, "pick", Job(job_id=name, queue=True))
        assert _send(bench, "cancel", Job(job_id="second")).ok
        assert bench.batches.jobs == ("first", ("third",))


def test_who_cancels_an_unknown_job_is_told_which_there_are() -> None:
    with _ready() as bench:
        _busy(bench)
        reply = _send(bench, "cancel", Job(job_id="other"))
        assert (reply.ok, reply.code) == (False, "NO_JOB")
        assert "first" in reply.advice


def test_a_cancelled_start_picks_no_further() -> None:
    with _ready() as bench:
        _busy(bench, cycles=5)
        assert _send(bench, "cancel", Job(job_id="first")).ok
        bench.actions.goes_on.set()
        bench.settle()
        assert not any(bench.batches.jobs)


def test_a_job_is_withdrawn_until_its_grasp_begins() -> None:
    withdrawal = Withdrawal()
    withdrawal.begin_cycle()
    withdrawal.begin_grasp()
    assert not withdrawal.cancel(), "the arm is on its way"
    withdrawal.begin_cycle()
    with pytest.raises(CycleFailure) as ended:
        withdrawal.begin_grasp()
    assert ended.value.failure is Code.CANCELLED


def test_a_late_job_does_not_begin_its_grasp() -> None:
    times_s = iter([0.0, 1.0, 3.0])
    withdrawal = Withdrawal(2.0, lambda: next(times_s))
    assert withdrawal.due() is None
    with pytest.raises(CycleFailure, match="2 s were over") as ended:
        withdrawal.begin_grasp()
    assert ended.value.failure is Code.DEADLINE


def test_a_cancel_and_a_grasp_that_begin_together_agree() -> None:
    for _ in range(200):
        withdrawal, outcomes = Withdrawal(), list[bool]()
        thread = threading.Thread(target=lambda w=withdrawal, o=outcomes: o.append(w.cancel()))
        thread.start()
        try:
            withdrawal.begin_grasp()
            has_begun = True
        except CycleFailure:
            has_begun = False
        thread.join()
        assert outcomes == [not has_begun]


# --- places -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [Place(position_m=(0.85, 0.65, 0.1)), Place(name="far")])
def test_a_place_out_of_reach_is_refused_before_anything_moves(place: Place) -> None:
    with _ready('scene.places=[{name="far", position_m=[0.85, 0.65, 0.1]}]') as bench:
        refused = _send(bench, "pick", Job(place=place))
        assert (refused.ok, refused.code) == (False, "BAD_JOB")
        assert "the place (0.85, 0.65, 0.10) cannot be reached" in refused.reason
        assert not bench.actions.begun


def test_a_full_place_takes_no_more_until_a_client_stops_and_resets_the_cell() -> None:
    job = Job(place=Place(name="left"))
    with _ready(PLACES) as bench:
        bench.actions.laid["left"] = 1
        reply = _send(bench, "pick", job)
        assert (reply.ok, reply.code) == (False, "PLACE_FULL")
        assert reply.advice == "Empty it, then stop and reset the cell: it counts anew then."
        bench.machine.command("stop", OPERATOR)
        bench.settle()
        bench.machine.command("reset", OPERATOR)
        bench.settle()
        assert _send(bench, "pick", job).ok


def test_a_reset_between_two_picks_does_not_forget_what_lies_at_a_place() -> None:
    job = Job(place=Place(name="left"))
    with _ready(PLACES) as bench:
        assert _send(bench, "pick", job).ok
        assert bench.settle() is State.COMPLETE
        bench.actions.laid["left"] = 1
        assert bench.machine.command("reset", OPERATOR).ok
        bench.settle()
        assert _send(bench, "pick", job).code == "PLACE_FULL"


def test_an_abort_and_its_clear_forget_nothing_either() -> None:
    with _ready(PLACES) as bench:
        bench.actions.laid["left"] = 1
        for verb in ("abort", "clear"):
            assert bench.machine.command(verb, OPERATOR).ok
            bench.settle()
        assert bench.actions.laid["left"] == 1


def test_a_job_whose_place_filled_up_meanwhile_is_dropped_with_the_reason() -> None:
    with _ready(PLACES) as bench:
        _busy(bench)
        _send(bench, "pick", Job(job_id="second", place=Place(name="left"), queue=True))
        bench.actions.laid["left"] = 1
        bench.actions.goes_on.set()
        bench.settle()
        assert bench.actions.begun == ["first"]
        assert any("second" in event and "full" in event for event in bench.publisher.events)


# --- clearing the way -------------------------------------------------------------------------------------------------


def test_what_lies_on_the_target_is_picked_first_and_then_the_target() -> None:
    retries = Retries(RetrySettings())
    job = Job(job_id="j", target=Target(text="red"), place=Place(name="left"), clear_way=True)
    first = Attempt(cycle_id="1", job=job)
    clearing = retries.after(first, Code.OBSTRUCTED, None, "2", "blue lies on red", np.array([0.4, 0.1, 0.05]))
    assert clearing is not None
    assert clearing.job.target == Target(point_m=(0.4, 0.1, 0.05))
    assert clearing.job.place is None, "it goes into the tray"
    assert clearing.then == (job,)
    again = retries.after(clearing, None, None, "3", "held")
    assert again is not None
    assert (again.job, again.then) == (job, ())
    assert [(one.cycle_id, one.code) for one in again.earlier] == [("1", Code.OBSTRUCTED), ("2", None)]
    assert retries.after(again, None, None, "4") is None


def test_without_being_asked_nothing_else_is_picked() -> None:
    first = Attempt(cycle_id="1", job=Job(target=Target(text="red")))
    assert Retries(RetrySettings()).after(first, Code.OBSTRUCTED, None, "2", "", np.array([0.4, 0.1, 0.05])) is None


# --- who comes and goes -----------------------------------------------------------------------------------------------


class _AsksAtOnce(Bench):
    """A machine whose client asks for another pick as soon as the result is said; the state is Completing still."""

    def __init__(self, *options: str) -> None:
        self.replies: list[CommandReply] = []
        self.open_cycle = ""
        super().__init__(lambda verb: None, *options)

    def _complete(self) -> None:
        super()._complete()
        self.actions.cycle_id = self.open_cycle
        if not self.replies:
            self.replies = [_send(self, "pick", Job(job_id=name)) for name in ("second", "third")]


def _asked_at_once(bench: _AsksAtOnce) -> list[CommandReply]:
    bench.machine.command("reset", OPERATOR)
    assert bench.settle() is State.IDLE
    assert _send(bench, "pick", Job(job_id="first")).ok
    assert bench.settle() is State.COMPLETE
    bench.close()
    return bench.replies


def test_a_client_that_asks_for_more_as_soon_as_it_has_its_result_is_not_refused() -> None:
    """Also where no job may wait; but only one comes next."""
    bench = _AsksAtOnce("queue.max=0")
    second, third = _asked_at_once(bench)
    assert (second.ok, second.position) == (True, 0)
    assert not third.ok
    assert bench.actions.begun == ["first", "second"]


def test_before_the_result_is_said_it_is_refused() -> None:
    bench = _AsksAtOnce()
    bench.open_cycle = "20260101T000000000"
    assert [reply.ok for reply in _asked_at_once(bench)] == [False, False]


class _GoesAtOnce(Bench):
    """A machine whose client goes as soon as the result is said; the state is Completing still."""

    def _complete(self) -> None:
        super()._complete()
        self.actions.cycle_id = ""  # closed
        self.batches.lose_lease("op", "its token is gone")
        asked = threading.Event()
        self.machine.decide(asked.set)
        assert asked.wait(60)


def test_a_client_that_goes_as_soon_as_it_has_its_result_leaves_no_held_cell() -> None:
    bench = _GoesAtOnce()
    bench.machine.command("reset", OPERATOR)
    assert bench.settle() is State.IDLE
    assert bench.machine.command("pick", OPERATOR).ok
    assert bench.settle() is State.COMPLETE
    assert not bench.actions.hold_state.gate.held
    bench.close()
