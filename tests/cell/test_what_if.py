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


Run = Callable[..., subprocess.CompletedProcess[str]]
_PAGE = (GOLDEN.parents[2] / "docs" / "first_hour.md").read_text()
(_FIRST_HOUR,) = re.findall(r"```\n(hand\.max_width_m.*?)```", _PAGE, re.DOTALL)


def _shape(text: str) -> str:
    """The text without its numbers."""
    return re.sub(r"\d+(\.\d+)?", "N", text)


def test_what_came_of_it_is_printed_first_and_the_details_are_asked_for(
    in_process: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    narrower = ("replay", str(GOLDEN), "--set", "hand.max_width_m=0.02")
    done = in_process(*narrower, "-o", "what-if.html")
    head, detect, plan, verify, count, page = done.stdout.splitlines()
    assert done.returncode == 1 and head == "hand.max_width_m = 0.02 (was 0.08): different"
    assert detect.startswith("  detect: 4 grasps") and " -> 2 grasps" in detect
    assert plan.startswith("  plan: grasp") and "mm away" in plan
    assert verify == "  verify: not replayed, another plan was executed"
    assert (count, page) == ("  25 values differ: --details", "  page what-if.html")
    assert len(in_process(*narrower, "--details").stdout.splitlines()) > 10
    assert _shape(_FIRST_HOUR) == _shape(done.stdout), "docs/first_hour.md shows it, of another recording"


def test_a_setting_that_changed_nothing_says_so_and_what_ran_again(in_process: Run) -> None:
    asked = ("hand.max_width_m=0.04", "execute.approve=holder", "hand.min_width_m=0.002")
    done = in_process("replay", str(GOLDEN), *(word for one in asked for word in ("--set", one)))
    said = done.stdout.splitlines()
    assert done.returncode == 0 and said[0].endswith("hand.min_width_m = 0.002 (as it was): equal, no decision changed")
    assert said[-1].startswith("  Only detect, plan, verify ran again: ")


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
