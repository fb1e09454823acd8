"""The advice of a result: that of its reason, where the reason knows more than the code; of a drop, that of its job."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bus.codes import ADVICE, DROPPED_BY_JOB, PLACE_OUT_OF_REACH, Code
from bus.errors import CycleFailure
from bus.messages import Attempt, GraspHints, Job
from cell.machine.gate import Gate
from cell.pick.cycle import Cycle
from cell.pick.stages import Stages

NO_JOB = Job()


def _advice(failure: CycleFailure, job: Job = NO_JOB) -> str:
    log = cast(Any, SimpleNamespace(path="c.mcap"))
    stages = Stages("c", lambda *_: None, lambda _: None, log, Gate())
    stages.fail(failure)
    return Cycle(Attempt(cycle_id="c", job=job), cast(Any, None), stages).result(retried_as="").advice


def test_a_failure_brings_its_own_advice_or_that_of_its_code() -> None:
    assert _advice(CycleFailure(Code.UNREACHABLE, "far")) == ADVICE[Code.UNREACHABLE]
    assert _advice(CycleFailure(Code.UNREACHABLE, "far", advice=PLACE_OUT_OF_REACH)) == PLACE_OUT_OF_REACH


@pytest.mark.parametrize(("force_n", "advice"), [(None, ADVICE[Code.DROPPED]), (0.5, DROPPED_BY_JOB)])
def test_what_a_job_held_too_gently_names_its_force(force_n: float | None, advice: str) -> None:
    job = Job(grasp=GraspHints(max_force_n=force_n))
    assert _advice(CycleFailure(Code.DROPPED, "It slipped."), job) == advice
