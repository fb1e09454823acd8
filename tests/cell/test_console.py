"""The progress an operator reads."""

from __future__ import annotations

import pytest

from bus import topics
from bus.codes import Code
from bus.commands import CellState
from bus.messages import CycleResult
from cell.cli.serving.console import Screen


def test_a_hold_shows_and_stages_that_go_on_under_it_do_not_repeat_it(capsys: pytest.CaptureFixture[str]) -> None:
    said = [("Execute", ""), ("Execute", "detect"), ("Holding", "detect"), ("Held", "detect"), ("Held", "plan"),
            ("Unholding", "plan"), ("Execute", "plan"), ("Execute", "execute"), ("Completing", "")]  # fmt: skip
    screen = Screen(json_lines=False, report=False)
    for state, stage in said:
        message = CellState(state=state, stage=stage, cycle_id="c", since_ns=0, available=(), reason="")
        screen.observe(topics.STATE, message)
    heard = screen.follow()
    for _ in said:
        next(heard)
    shown = ["Execute", "Holding", "Held", "Unholding", "Execute", "Completing"]
    assert capsys.readouterr().out.split() == shown


def test_what_became_of_an_interrupted_cycle_is_the_last_line(capsys: pytest.CaptureFixture[str]) -> None:
    stopped = CycleResult(
        cycle_id="c", object="cup", result="ABORTED", code=Code.STOPPED, reason="Stopped during 'reach'.",
        stages={}, wall_s=1.0, recording="recordings/c.mcap",
    )  # fmt: skip
    screen = Screen(json_lines=False, report=False)
    with screen.to_the_end():
        screen.interrupted.set()
        assert list(screen.follow()) == []
        stopping = CellState(state="Stopping", stage="", cycle_id="c", since_ns=0, available=(), reason="")
        screen.observe(topics.STATE, stopping)
        screen.observe(topics.RESULT, stopped)
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].startswith("ABORTED STOPPED") and "Stopped during 'reach'." in shown[0]
    assert shown[-1] == "  recording recordings/c.mcap"
