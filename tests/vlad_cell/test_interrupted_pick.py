"""How a program waits for picks: to their end, though messages are lost, jobs dropped, or Ctrl-C comes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import cast

import pytest

from bus import topics
from bus.codec import encode
from bus.commands import CellState, CommandReply, CommandRequest
from bus.errors import CellUnreachable, NotReached, Refused, ReplyTimeout
from bus.messages import CycleResult, Job
from bus.sample import Sample
from cell.client import Client
from cell.daemon.batch import Batch
from cell.following import GRACE_S
from cell.outcome import Outcome
from vlad_cell import Pick
from vlad_cell.picks import Picks

STATE = CellState(state="Execute", stage="execute", cycle_id="c", since_ns=0, available=(), reason="")
RESULT = CycleResult(
    cycle_id="c", object="cup", result="SUCCESS", code=None, reason="Held.", stages={}, wall_s=1.0, recording=""
)


@dataclass
class Heard:
    """A client that hears this, one after the other; an error is raised. ``known``: what the cell says when asked."""

    said: list[CellState | CycleResult | BaseException | None] = field(default_factory=list)
    known: dict[str, CycleResult] = field(default_factory=dict)
    now: CellState = STATE
    is_gone: bool = False
    is_released: bool = False

    def next_heard(self, timeout_s: float) -> Sample | None:
        if not self.said:
            return None
        said = self.said.pop(0)
        if isinstance(said, BaseException):
            raise said
        if said is None:
            return None
        topic = topics.STATE if isinstance(said, CellState) else topics.RESULT
        return Sample(topic.key, "", encode(said))

    def result(self, cycle_id: str) -> CycleResult | None:
        return self.known.get(cycle_id)

    def state(self) -> CellState:
        return self.now

    def release(self) -> None:
        self.is_released = True

    def pick(self) -> Pick:
        return Pick(cast(Client, self), "c", "mine", 0)

    def picks(self, cycles: int) -> Picks:
        """So many picks, at a clock that goes on by `GRACE_S` at every look."""
        reply = CommandReply(ok=True, state="Starting", cycle_id="c", job_id="mine")
        seconds = itertools.count(0.0, GRACE_S)
        return Picks(cast(Client, self), Batch(CommandRequest(cycles=cycles)), reply, lambda: next(seconds))


def test_ctrl_c_gives_the_lease_back() -> None:
    heard = Heard([STATE, KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        heard.pick().wait()
    assert heard.is_released


def test_an_error_of_the_program_s_own_gives_the_lease_back() -> None:
    """Nobody waits for the motion any more, so the cell holds it."""

    def count(line: str) -> None:
        raise ZeroDivisionError(line)

    heard = Heard([STATE])
    with pytest.raises(ZeroDivisionError):
        heard.pick().wait(progress=count)
    assert heard.is_released


def test_a_pick_in_a_notebook_says_what_became_of_it() -> None:
    pick = Heard([RESULT]).pick()
    assert repr(pick) == "Pick c, begun"
    pick.wait()
    assert repr(pick) == "Pick c, SUCCESS"


def test_a_retry_is_followed_to_its_result_and_each_line_is_told_once() -> None:
    tried = RESULT.model_copy(update={"result": "FAILED", "retried_as": "d"})
    last = RESULT.model_copy(update={"cycle_id": "d"})
    lines: list[str] = []
    heard = Heard([STATE, STATE, tried, last])
    assert heard.pick().wait(progress=lines.append) == last
    assert lines == ["Execute execute", "FAILED cup: Held.", "SUCCESS cup: Held."] and not heard.is_released


def test_a_result_that_was_not_heard_is_asked_for() -> None:
    assert Heard([STATE, None], {"c": RESULT}).pick().wait() == RESULT


def test_a_wait_that_is_over_keeps_the_lease() -> None:
    heard = Heard([STATE])
    with pytest.raises(ReplyTimeout, match="Cycle c"):
        heard.pick().wait(timeout_s=0.0)
    assert not heard.is_released


def test_a_cell_that_is_gone_ends_the_wait() -> None:
    with pytest.raises(CellUnreachable):
        Heard([STATE], is_gone=True).pick().wait()


# --- what never comes -------------------------------------------------------------------------------------------------

STOPPED = STATE.model_copy(update={"state": "Stopped", "stage": "", "cycle_id": ""})


def test_a_job_that_was_dropped_has_no_result() -> None:
    """A result that comes a little after the stop still counts."""
    seconds = iter((0.0, 4.9, 5.0))
    outcome = Outcome(Heard(now=STOPPED), "c", "mine", grace_s=5.0, now_s=lambda: next(seconds))
    assert outcome.ask() is None and outcome.ask() is None
    with pytest.raises(Refused) as dropped:
        outcome.ask()
    assert dropped.value.code == "JOB_DROPPED"


@pytest.mark.parametrize("waits", [{"job_id": "mine"}, {"queue": ("mine",)}, {"state": "Execute"}])
def test_a_job_that_waits_or_is_under_way_is_not_dropped(waits: dict[str, object]) -> None:
    outcome = Outcome(Heard(now=STOPPED.model_copy(update=waits)), "c", "mine")
    assert [outcome.ask() for _ in range(3)] == [None] * 3


def test_the_iteration_over_a_dropped_pick_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.following.GRACE_S", 0.0)
    with pytest.raises(Refused, match="dropped"):
        list(Heard([STATE], now=STOPPED).pick())


MINE = RESULT.model_copy(update={"job": Job(job_id="mine")})
NEXT = STATE.model_copy(update={"cycle_id": "d", "job_id": "mine"})


def test_of_several_picks_a_result_that_was_not_heard_is_asked_for_and_counts_once() -> None:
    last = MINE.model_copy(update={"cycle_id": "d"})
    heard = Heard([STATE, NEXT, None, MINE], {"c": MINE, "d": last})
    assert list(heard.picks(2)) == [MINE, last]
    assert list(Heard([MINE, MINE, last]).picks(2)) == [MINE, last]


def test_who_leaves_the_loop_of_several_picks_before_the_end_gives_the_lease_back() -> None:
    heard = Heard([MINE, MINE.model_copy(update={"cycle_id": "d"})])
    results = iter(heard.picks(3))
    assert next(results) == MINE and not heard.is_released
    results.close()  # type: ignore[attr-defined] # what `break` does
    assert heard.is_released
    whole = Heard([MINE])
    assert list(whole.picks(1)) == [MINE] and not whole.is_released


@pytest.mark.parametrize(
    ("now", "why"),
    [
        (STOPPED, "After 1 of the picks the cell is Stopped"),
        (STOPPED.model_copy(update={"state": "Complete"}), "The cell ended the job after 1 of the picks"),
    ],
)
def test_several_picks_end_with_the_cell_though_nothing_is_heard(now: CellState, why: str) -> None:
    picks = iter(Heard(known={"c": MINE}, now=now).picks(2))
    assert next(picks) == MINE
    with pytest.raises(NotReached, match=why):
        next(picks)
