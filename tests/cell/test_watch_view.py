"""What an operator reads in ``cell watch``."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from bus import topics
from bus.codes import Code
from bus.commands import CellState, Event, Health
from bus.messages import ArmMode, ArmState, CycleResult, View
from cell.cli.picks.watch_screen import HISTORY, Model, view

NOW_S, NOW_NS = 100.0, 50_000_000_000
EMPTY = Model("lab", ("robot", "camera"), takes_keys=True)


def _state(name: str, since_s: float = 45.0, **more: object) -> CellState:
    fields = {"stage": "", "cycle_id": "", "available": (), "reason": "", **more}
    return CellState.model_validate({"state": name, "since_ns": int(since_s * 1e9), **fields})


def _result(number: int, code: Code | None = None, reason: str = "") -> CycleResult:
    return CycleResult(cycle_id=f"cycle-{number:02d}", object="cup", result="SUCCESS" if code is None else "FAILED",
                       code=code, reason=reason, stages={}, wall_s=7.3, recording="")  # fmt: skip


def _drawn(model: Model) -> Console:
    console = Console(record=True, width=120, force_terminal=True, color_system="standard", file=StringIO())
    console.print(view(model, NOW_S, NOW_NS))
    return console


def _text(model: Model) -> str:
    return _drawn(model).export_text()


def test_state_stage_cycle_and_reason_stand_on_top() -> None:
    said = _state("Execute", stage="plan", cycle_id="20261123T104703818", reason="command 'pick' from me")
    first, second = _text(EMPTY.hear(said, NOW_S)).splitlines()[:2]
    assert first.split() == ["cell", "lab", "Execute", "plan", "cycle", "20261123T104703818", "for", "5", "s"]
    assert second.strip() == "command 'pick' from me"


def test_only_what_is_available_is_lit() -> None:
    drawn = _drawn(EMPTY.hear(_state("Stopped", available=("reset", "abort")), NOW_S)).export_text(styles=True)
    bold, dim = "\x1b[1m", "\x1b[2m"
    assert f"{bold}r reset" in drawn and f"{bold}a abort" in drawn and f"{bold}q quit" in drawn
    assert all(f"{dim}{key}" in drawn for key in ("p pick", "s stop", "h hold", "u unhold", "c clear"))


def test_without_a_keyboard_it_names_no_keys() -> None:
    shown = _text(replace(EMPTY, takes_keys=False).hear(_state("Stopped", available=("reset", "abort")), NOW_S))
    assert "available: reset, abort" in shown and "quit" not in shown


def test_the_last_eight_results_newest_first_each_once() -> None:
    model = EMPTY
    for number in range(12):
        model = model.hear(_result(number), NOW_S)
    model = model.hear(_result(11), NOW_S)
    shown = [line.split()[0] for line in _text(model).splitlines() if line.startswith("cycle-")]
    assert shown == [f"cycle-{number:02d}" for number in range(11, 11 - HISTORY, -1)]


def test_a_failure_shows_its_code_and_reason_as_they_are() -> None:
    model = EMPTY.hear(_result(1, Code.GRASP_MISSED, "Closed on [bold]air[/]."), NOW_S)
    (line,) = [line for line in _text(model).splitlines() if line.startswith("cycle-01")]
    assert line.split()[:6] == ["cycle-01", "FAILED", "GRASP_MISSED", "cup", "7.3", "s"]
    assert line.rstrip().endswith("  Closed on [bold]air[/].")


def test_a_node_shows_its_age_its_counts_and_its_readings() -> None:
    health = Health(name="camera", pid=7, uptime_s=3600, answered=41, failed=2, readings={"camera.ir_c": 41.25})
    lines = _text(EMPTY.hear(health, NOW_S - 9.0)).splitlines()
    (camera,) = [line for line in lines if line.startswith("camera")]
    (robot,) = [line for line in lines if line.startswith("robot")]
    assert camera.split() == ["camera", "9", "s", "ago", "60", "min", "41", "2", "camera.ir_c", "41.25"]
    assert robot.split()[:3] == ["robot", "not", "yet"]


def test_a_silent_node_is_red() -> None:
    health = Health(name="camera", pid=7, uptime_s=1, answered=0, failed=0)
    red = "\x1b[1;31m"
    assert f"{red}9 s ago" in _drawn(EMPTY.hear(health, NOW_S - 9.0)).export_text(styles=True)
    assert f"{red}1 s ago" not in _drawn(EMPTY.hear(health, NOW_S - 1.0)).export_text(styles=True)


def test_an_older_state_that_arrives_late_changes_nothing() -> None:
    model = EMPTY.hear(_state("Idle", 45.0), NOW_S).hear(_state("Resetting", 44.0), NOW_S)
    assert model.state is not None and model.state.state == "Idle"


def test_a_cell_that_does_not_answer_offers_nothing_and_may_come_back_with_an_older_clock() -> None:
    model = replace(EMPTY.hear(_state("Idle", available=("pick",)), NOW_S), lost="Nobody answers 'state'.")
    assert "Nobody answers 'state'." in _text(model)
    assert "\x1b[2mp pick" in _drawn(model).export_text(styles=True)
    back = model.hear(_state("Stopped", 1.0), NOW_S)
    assert back.lost == "" and back.state is not None and back.state.state == "Stopped"


def test_an_event_is_the_note_and_has_an_age() -> None:
    said = Event(code="GAVE_UP", severity="error", text="3 picks in a row failed.", advice="Look.")
    assert "GAVE_UP 3 picks in a row failed. Look.  4 s ago" in _text(EMPTY.hear(said, NOW_S - 4.0))


@pytest.mark.parametrize("since_ns", [10**400, -(10**400)])
def test_a_stamp_of_any_size_can_be_shown(since_ns: int) -> None:
    said = _state("Idle").model_copy(update={"since_ns": since_ns})
    assert "Idle" in _text(EMPTY.hear(said, NOW_S))


def test_who_stopped_the_cell_stands_below_its_state() -> None:
    model = EMPTY.hear(_state("Stopping", 1.0, reason="command 'stop' from watch-ann-lab2-4711"), NOW_S)
    assert "Stopping by watch-ann-lab2-4711" in _text(model)
    assert "Stopped by watch-ann-lab2-4711" in _text(model.hear(_state("Stopped", 2.0), NOW_S))


def test_what_could_not_be_read_is_one_line_that_commands_no_terminal() -> None:
    model = EMPTY
    for why in ("torn", "not\x1b[2J a\nHealth"):
        model = model.missing("node/camera/health", why)
    assert "2 messages could not be read, the last on node/camera/health: not a Health" in _text(model)


def test_a_further_look_is_noted_with_its_reason() -> None:
    arm = ArmState(stamp_ns=1, mode=ArmMode.IDLE, q_rad=np.zeros(7), dq_rad_s=np.zeros(7), tau_ext_nm=np.zeros(7))
    seen = View(stamp_ns=1, arm=arm, base_from_color=np.eye(4), why="too little was seen")
    capture = topics.CAPTURE.says(
        cycle_id="1", stage="capture", started_ns=1, duration_s=0.6, result=seen, failure=None
    )
    assert "looked again: too little was seen" in _text(EMPTY.hear(capture, NOW_S))
    first = capture.model_copy(update={"result": seen.model_copy(update={"why": ""})})
    assert EMPTY.hear(first, NOW_S) == EMPTY
