"""The picks of one `start`: when another follows, and when it is over."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from bus.codes import Code
from bus.commands import CommandRequest
from bus.messages import CycleResult
from cell.daemon.batch import Batch

UNTIL_EMPTY = CommandRequest(until_empty=True)


def heard(batch: Batch, *results: str) -> Batch:
    for result in results:
        code = {"FAILED": Code.DROPPED, "ABORTED": Code.ARM_REFLEX, "EMPTY": Code.NO_OBJECT}.get(result)
        batch.hear(
            CycleResult.model_validate(
                {
                    "cycle_id": "1",
                    "object": "",
                    "result": result,
                    "code": code,
                    "reason": "why",
                    "stages": {},
                    "wall_s": 1.0,
                    "recording": "",
                }
            )
        )
    return batch


def test_so_many_picks_and_no_more() -> None:
    batch = heard(Batch(CommandRequest(cycles=3)), "SUCCESS", "FAILED")
    assert not batch.is_over
    assert heard(batch, "FAILED").is_over and (batch.picked, batch.failed) == (1, 2)


def test_so_many_picks_never_give_up() -> None:
    assert not heard(Batch(CommandRequest(cycles=9)), *["FAILED"] * 5).is_over


def test_until_empty_goes_on_until_a_pick_finds_nothing() -> None:
    batch = heard(Batch(UNTIL_EMPTY), *["SUCCESS"] * 40)
    assert not batch.is_over
    assert heard(batch, "EMPTY").is_over and batch.is_empty


def test_three_failures_in_a_row_end_it_with_the_last_reason() -> None:
    batch = heard(Batch(UNTIL_EMPTY), "FAILED", "FAILED", "SUCCESS", "FAILED", "FAILED")
    assert not batch.is_over
    assert heard(batch, "FAILED").gave_up and not batch.is_empty
    assert batch.reason == "3 picks in a row failed, the last by DROPPED: why"


@pytest.mark.parametrize("code", [Code.NO_GRASP, Code.COLLISION, Code.NOT_SEEN])
def test_two_that_touch_nothing_end_it_because_the_next_would_find_the_same_scene(code: Code) -> None:
    untouched = CycleResult.model_validate(
        {"cycle_id": "1", "object": "", "result": "FAILED", "code": code, "reason": "why",
         "stages": {"capture": 1.0, "detect": 1.0}, "wall_s": 1.0, "recording": ""}
    )  # fmt: skip
    batch, counted, retried = Batch(UNTIL_EMPTY), Batch(CommandRequest(cycles=3)), Batch(UNTIL_EMPTY)
    for _ in range(2):
        assert not batch.is_over
        batch.hear(untouched)
        counted.hear(untouched)
        retried.hear(untouched.model_copy(update={"retried_as": "2"}))
    assert batch.gave_up and not batch.is_empty and batch.reason == f"2 picks in a row failed, the last by {code}: why"
    assert not counted.is_over and not retried.is_over


@pytest.mark.parametrize("request_", [UNTIL_EMPTY, CommandRequest(cycles=5)])
def test_a_fault_ends_every_batch(request_: CommandRequest) -> None:
    batch = heard(Batch(request_), "SUCCESS", "ABORTED")
    assert batch.is_over and not batch.is_empty and "ARM_REFLEX" in batch.reason


def test_the_summary_says_what_nobody_knows() -> None:
    batch = heard(Batch(UNTIL_EMPTY), "SUCCESS", "FAILED", "EMPTY")
    assert batch.summary(0).line() == "picked 1, failed 1, objects left: 0. why"
    assert "objects left: unknown" in batch.summary(None).line()


def test_a_number_and_until_empty_exclude_each_other() -> None:
    with pytest.raises(ValidationError, match="not both"):
        CommandRequest(cycles=2, until_empty=True)


def test_when_only_things_are_left_that_failed_before_picks_until_empty_end_and_others_go_on() -> None:
    left = CycleResult.model_validate(
        {"cycle_id": "1", "object": "", "result": "FAILED", "code": Code.LEFT_OVER, "reason": "2 things are left.",
         "stages": {}, "wall_s": 1.0, "recording": ""}
    )  # fmt: skip
    batch, counted = Batch(UNTIL_EMPTY), Batch(CommandRequest(cycles=3))
    batch.hear(left)
    counted.hear(left)
    assert batch.is_over and not batch.is_empty and not batch.gave_up and batch.reason == "2 things are left."
    assert not counted.is_over
