"""``cell pick`` and ``cell run`` without a cell: what they show, when they are over, what Ctrl-C leaves behind."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from bus import topics
from bus.codec import encode
from bus.codes import Code
from bus.commands import CellState, CommandReply
from bus.messages import CycleResult, Job, Proposal
from bus.sample import Sample
from cell import client

Run = Callable[..., subprocess.CompletedProcess[str]]
STOPPED_BY = "command 'stop' from watch-ann-lab2-4711"
Said = CellState | CycleResult | type[KeyboardInterrupt]


PROPOSAL = Proposal(
    proposal_id="c-0", cycle_id="c", grasp=3, base_from_tcp=np.eye(4), score=0.87, opening_m=0.05, object="red cup",
    motion_s=6.2, segments_s={}, rejected=0, passed_over=0, until_ns=0,
)  # fmt: skip


def _state(name: str, reason: str = "") -> CellState:
    return CellState(state=name, stage="", cycle_id="", since_ns=0, available=(), reason=reason)


def _result(cycle_id: str, result: str = "SUCCESS", code: Code | None = None, retried_as: str = "") -> CycleResult:
    fields = {"object": "[cup]", "reason": "Held.", "stages": {}, "wall_s": 1.0, "recording": "r.mcap"}
    said = {"cycle_id": cycle_id, "result": result, "code": code, "retried_as": retried_as, **fields}
    return CycleResult.model_validate(said)


class ScriptedCell:
    """A connection that accepts every command as the cycle ``1``, and says what a test tells it to."""

    def __init__(self, said: list[Said]) -> None:
        self._said = iter(said)
        self.commands: list[tuple[str, dict[str, Any]]] = []
        self.reply = CommandReply(ok=True, state="Starting", cycle_id="1")
        self.now = _state("Complete")

    def command(self, verb: str, **arguments: Any) -> CommandReply:
        self.commands.append((verb, arguments))
        return self.reply

    def state(self) -> CellState:
        return self.now

    def proposal(self) -> Proposal:
        return PROPOSAL

    def next_heard(self, timeout_s: float) -> Sample:
        said = self.next_said(timeout_s)
        topic = topics.STATE if isinstance(said, CellState) else topics.RESULT
        return Sample(topic.key, "", encode(said))

    def next_said(self, _timeout_s: float) -> CellState | CycleResult:
        said = next(self._said)
        if isinstance(said, CellState | CycleResult):
            return said
        raise said


@pytest.fixture
def says(monkeypatch: pytest.MonkeyPatch) -> Callable[..., ScriptedCell]:
    """Makes the cell that commands connect to."""

    def make(*said: Said) -> ScriptedCell:
        cell = ScriptedCell(list(said))

        @contextmanager
        def connect(*_: object, **__: object) -> Iterator[ScriptedCell]:
            yield cell

        monkeypatch.setattr(client, "connect", connect)
        return cell

    return make


Says = Callable[..., ScriptedCell]


def test_a_pick_waits_for_the_result_of_its_last_try(in_process: Run, says: Says) -> None:
    stages = [_state("Execute").model_copy(update={"stage": stage}) for stage in ("plan", "plan", "approve")]
    said = (*stages, _result("0"), _result("1", "FAILED", Code.GRASP_MISSED, retried_as="2"), _result("2"))
    says(*said)
    done = in_process("pick")
    begins, plan, asks, waits, *told = done.stdout.splitlines()
    assert (begins, plan) == ("cycle 1 begins; Ctrl-C holds it", "  plan")
    assert asks == "  approve" and waits.startswith("  c-0: red cup, score 0.87, 6.2 s of motion; an answer counts")
    assert "nothing moves until somebody answers: cell approve" in waits
    missed = ["FAILED GRASP_MISSED [cup]: Held.", "  r.mcap", "tried again as 2"]
    assert told == [*missed, "SUCCESS [cup]: Held.", "  r.mcap"]
    says(*said)
    (only,) = in_process("pick", "--json").stdout.splitlines()
    assert '"cycle_id":"2"' in only, "for a program the last try alone is the answer"


def test_it_says_who_stopped_it(in_process: Run, says: Says) -> None:
    says(_state("Stopping", STOPPED_BY), _result("1", "ABORTED", Code.STOPPED))
    done = in_process("pick")
    assert done.returncode == 1 and "  Stopping by watch-ann-lab2-4711" in done.stdout.splitlines()


def test_ctrl_c_says_what_the_cell_does_now_and_how_to_go_on(in_process: Run, says: Says) -> None:
    for command in (["pick"], ["run", "--cycles", "3"]):
        says(_state("Execute"), KeyboardInterrupt)
        done = in_process(*command)
        assert done.returncode == 130 and "Traceback" not in done.stderr
        assert all(words in done.stderr for words in ("holds it", "cell unhold", "cell stop"))


def test_a_run_is_over_with_its_last_pick(in_process: Run, says: Says) -> None:
    cell = says(_result("1"), _state("Complete"), _state("Execute"), _result("2"))
    done = in_process("run", "--cycles", "2", "--json")
    assert done.returncode == 0 and [json.loads(line)["cycle_id"] for line in done.stdout.splitlines()] == ["1", "2"]
    assert cell.commands == [("start", {"cycles": 2, "until_empty": False, "job": Job()})]


def test_a_run_until_empty_ends_with_its_sum(in_process: Run, says: Says) -> None:
    cell = says(_result("1"), _result("2", "EMPTY"))
    done = in_process("run", "--until-empty")
    assert done.returncode == 0 and "picked 1, failed 0" in done.stdout.splitlines()[-1]
    assert cell.commands == [("start", {"cycles": 1, "until_empty": True, "job": Job()})]


@pytest.mark.parametrize(("state", "reason"), [("Stopped", STOPPED_BY), ("Aborted", "DEVICE_LOST The arm is gone.")])
def test_a_run_that_is_stopped_or_aborts_is_no_success(in_process: Run, says: Says, state: str, reason: str) -> None:
    says(_result("1"), _state(state.replace("ed", "ing"), reason), _state(state))
    done = in_process("run", "--until-empty")
    assert done.returncode == 1 and reason.rpartition("from ")[2] in done.stdout.splitlines()[-1]


@pytest.mark.parametrize("command", [("pick", "--queue"), ("run", "--cycles", "2", "--queue")])
def test_who_waits_for_a_job_that_is_cancelled_is_told(in_process: Run, says: Says, command: tuple[str, ...]) -> None:
    working = _state("Execute").model_copy(update={"job_id": "other", "queue": ("mine",)})
    cancelled = working.model_copy(update={"queue": ()})
    cell = says(_state("Execute"), working, cancelled, cancelled, _state("Complete"))
    cell.reply, cell.now = CommandReply(ok=True, state="Execute", cycle_id="1", job_id="mine", position=1), cancelled
    done = in_process(*command)
    told, refused = done.stderr.splitlines()
    assert told == "job mine will not begin; what moves is attended from here; Ctrl-C holds it"
    assert done.returncode == 3 and refused.startswith("JOB_DROPPED: The job 'mine' ended without a cycle")


def test_a_waiting_job_that_begins_is_followed_to_its_result(in_process: Run, says: Says) -> None:
    working = _state("Execute").model_copy(update={"job_id": "other", "queue": ("mine",)})
    begun, over = (working.model_copy(update={"job_id": job_id, "queue": ()}) for job_id in ("mine", ""))
    cell = says(working, begun, over, _result("1"))
    cell.reply = CommandReply(ok=True, state="Execute", cycle_id="1", job_id="mine", position=1)
    assert in_process("pick", "--queue").returncode == 0
