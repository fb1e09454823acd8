"""A what-if as a page: the recorded cycle up to the stage that ran again, and what came of another setting."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from bus.messages import Failure
from cell.replay.replay import Replay, Request, replay
from cell.replay.what_if import WHAT_IF, what_if
from logs.mcap.reader import read_cycle
from logs.report.cycle_report import write_report
from logs.report.timeline import summarize

GOLDEN = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"
NARROW = "hand.max_width_m=0.012"


@pytest.fixture(scope="module")
def outcome() -> Replay:
    return replay(read_cycle(GOLDEN), Request.of([NARROW], None, None))


def test_what_followed_from_the_recorded_decision_is_left_out(outcome: Replay) -> None:
    asked = what_if(outcome, [NARROW])
    assert list(asked.stages) == ["capture", "detect"]
    assert asked.result is None and asked.after is None and not asked.states
    assert asked.looks == outcome.record.looks
    failure = asked.stages["detect"].failure
    assert isinstance(failure, Failure) and failure.code == "NO_GRASP"


def test_its_page_says_what_was_changed_and_what_came_of_it(outcome: Replay, tmp_path: Path) -> None:
    asked = what_if(outcome, [NARROW])
    told = summarize(asked)
    assert (
        told.outcome == WHAT_IF and NARROW in told.why and "-> NO_GRASP" in told.why and "jaw opens 12 mm" in told.why
    )
    text = write_report(asked, tmp_path / "page.html").read_text()
    assert re.search(r"max_width_m.*0\.012.*0\.08", text, re.DOTALL), "the setting is among the changed ones"


def test_its_page_shows_what_the_model_was_asked_for_it_and_not_what_was_recorded() -> None:
    again = replay(read_cycle(GOLDEN), Request.of(["hand.max_width_m=0.03"], None, None))
    prompts = [reply.prompt for reply in what_if(again, ["hand.max_width_m=0.03"]).replies if reply.step == "reason"]
    assert prompts and all("opens at most 30 mm" in prompt for prompt in prompts)
    assert any("opens at most 80 mm" in reply.prompt for reply in again.record.replies)


def test_a_replay_of_later_stages_keeps_the_recorded_replies() -> None:
    later = replay(read_cycle(GOLDEN), Request.of(["planning.max_held_acceleration_m_s2=3.0"], "plan", None))
    assert what_if(later, []).replies == later.record.replies


@pytest.mark.thorough
def test_the_tour_shows_three_cycles_and_their_pages(
    in_process: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    done = in_process("tour", "--folder", str(tmp_path))
    assert done.returncode == 0, done.stderr
    pages = re.findall(r"file://(\S+\.html)", done.stdout)
    assert len(pages) == 3 and all(Path(page).is_file() for page in pages)
    assert "SUCCESS spatula" in done.stdout and "FAILED TARGET_NOT_FOUND" in done.stdout
    assert "chosen grasp" in done.stdout and "mm away" in done.stdout
