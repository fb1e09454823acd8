"""How long `cell pick` waits: to the result, or until the cell has ended without one."""

from __future__ import annotations

from typing import cast

import pytest

from bus import topics
from bus.codec import encode
from bus.commands import CellState, CommandReply
from bus.errors import Refused
from bus.messages import CycleResult
from bus.sample import Sample
from cell import following
from cell.cli.picks import pick
from cell.cli.picks.queued_job import QueuedJob
from cell.client import Client

BEGUN = CommandReply(ok=True, state="Starting", available=(), cycle_id="c", job_id="c")
ABORTING = CellState(state="Aborting", stage="", cycle_id="", since_ns=0, available=(), reason="Only 0 MB are free.")
ABORTED = CellState(
    state="Aborted", stage="", cycle_id="", since_ns=1, available=("clear",), reason="Only 0 MB are free."
)
STOPPED = CycleResult(
    cycle_id="c", object="", result="ABORTED", code=None, reason="", stages={}, wall_s=0.0, recording=""
)


class Ended:
    """A cell that was aborted, and what it says when it is asked for the result, one after the other."""

    is_gone = False

    def __init__(self, *results: CycleResult | None, said: tuple[CellState, ...] = (ABORTING, ABORTED)) -> None:
        self._results, self._states = list(results), list(said)

    def next_heard(self, _timeout_s: float) -> Sample | None:
        return Sample(topics.STATE.key, "", encode(self._states.pop(0))) if self._states else None

    def state(self) -> CellState:
        return ABORTED

    def result(self, _cycle_id: str) -> CycleResult | None:
        return self._results.pop(0)


def _waited_for(cell: Ended) -> CycleResult:
    waiting = QueuedJob(cell, BEGUN, lambda line: None)
    return pick._result_of(cast(Client, cell), BEGUN, pick._Shown(False, cast(Client, cell)), waiting)


def test_a_result_that_comes_after_the_abort_is_waited_for() -> None:
    assert _waited_for(Ended(None, None, STOPPED)) is STOPPED


def test_a_cycle_that_never_began_has_none_and_is_not_waited_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As with a full disk: the cell aborts before the cycle has a recording."""
    monkeypatch.setattr(following, "GRACE_S", 0.0)
    with pytest.raises(Refused) as refusal:
        _waited_for(Ended(None, None, None))
    assert refusal.value.code == "JOB_DROPPED"
    assert capsys.readouterr().out.strip() == "Only 0 MB are free."


def test_a_result_that_was_not_heard_is_asked_for() -> None:
    assert _waited_for(Ended(STOPPED, said=())) is STOPPED
