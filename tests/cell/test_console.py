"""The progress an operator reads."""

from __future__ import annotations

import pytest

from bus import topics
from bus.commands import CellState
from cell.cli.console import Screen


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
