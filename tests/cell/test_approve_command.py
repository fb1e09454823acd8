"""``cell approve`` and ``cell status``: a person sees what waits before the arm moves, and names nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from bus.commands import CellHealth, CellState, CommandRequest
from bus.errors import Refused
from bus.messages import Proposal
from cell import client

Run = Callable[..., subprocess.CompletedProcess[str]]
Types = Callable[[str], None]
WAITS = CellState(
    state="Execute", stage="approve", cycle_id="c", since_ns=0, available=("approve",), reason="", job_id="order-17",
    asked_by="line-3",
)  # fmt: skip


def _proposal(object_text: str = "red 40 x 30 x 20 mm at (0.42, -0.16)") -> Proposal:
    place = np.eye(4)
    place[:3, 3] = 0.42, -0.16, 0.03
    return Proposal(
        proposal_id="c-1", cycle_id="c", grasp=3, base_from_tcp=place, score=0.871, opening_m=0.05, object=object_text,
        motion_s=6.24, segments_s={}, rejected=0, passed_over=0, until_ns=time.time_ns() + 90_000_000_000,
    )  # fmt: skip


class Waiting:
    """A cell in which a planned pick waits, or nothing does."""

    def __init__(self, proposal: Proposal | None) -> None:
        self.waits = proposal
        self.sent: list[tuple[str, str]] = []

    def proposal(self) -> Proposal:
        if self.waits is None:
            raise Refused("No planned motion waits for an answer.", "", code="NO_PROPOSAL")
        return self.waits

    def send(self, verb: str, request: CommandRequest) -> None:
        self.sent.append((verb, request.proposal))

    def state(self) -> CellState:
        return WAITS

    def health(self) -> CellHealth:
        return CellHealth(is_healthy=True, nodes={})


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Waiting:
    """The cell that commands connect to."""
    return _connected(monkeypatch, Waiting(_proposal()))


def _connected(monkeypatch: pytest.MonkeyPatch, cell: Waiting) -> Waiting:
    @contextmanager
    def connect(*_: object, **__: object) -> Iterator[Waiting]:
        yield cell

    monkeypatch.setattr(client, "connect", connect)
    return cell


@pytest.fixture
def types(monkeypatch: pytest.MonkeyPatch) -> Types:
    """A person at a terminal who types a line, or with "" closes it."""

    def line(typed: str) -> None:
        lines = iter([typed] if typed else [])
        terminal = SimpleNamespace(isatty=lambda: True, readline=lambda: next(lines, ""))
        monkeypatch.setattr(sys, "stdin", terminal)
        monkeypatch.setattr("click.termui.visible_prompt_func", lambda _prompt="": next(lines, None) or _closed())

    return line


def _closed() -> str:
    raise EOFError


@pytest.mark.parametrize(
    ("typed", "sent", "code"),
    [("y\n", [("approve", "c-1")], 0), ("n\n", [], 1), ("\n", [], 1), ("", [], 1)],
    ids=["yes", "no", "only Return", "a closed terminal"],
)
def test_at_a_terminal_it_shows_what_waits_and_asks_before_the_arm_moves(
    in_process: Run, cell: Waiting, types: Types, typed: str, sent: list[tuple[str, str]], code: int
) -> None:
    types(typed)
    done = in_process("approve")
    assert (cell.sent, done.returncode) == (sent, code)
    assert "c-1: red 40 x 30 x 20 mm at (0.42, -0.16), score 0.87, 6.2 s of motion; an answer counts for" in done.stderr
    assert ("nothing moves" in done.stderr) is (sent == [])


def test_who_names_it_or_says_yes_is_not_asked(in_process: Run, cell: Waiting) -> None:
    assert in_process("approve", "c-1").returncode == in_process("approve", "--yes").returncode == 0
    assert cell.sent == [("approve", "c-1")] * 2, "always by its name: nobody approves another than was shown"


def test_a_script_says_what_it_approves(in_process: Run, cell: Waiting, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    done = in_process("approve")
    assert done.returncode == 2 and "--yes" in done.stderr and cell.sent == []


def test_the_status_says_what_waits(in_process: Run, cell: Waiting) -> None:
    said = in_process("status").stdout
    assert "  waits for approval: c-1: red 40 x 30 x 20 mm at (0.42, -0.16), score 0.87, 6.2 s of motion" in said
    assert json.loads(in_process("status", "--json").stdout)["proposal"]["proposal_id"] == "c-1"


def test_the_status_says_which_job_is_under_way_and_who_asked_for_it(in_process: Run, cell: Waiting) -> None:
    said = in_process("status").stdout
    assert "  job: order-17, waiting: -\n  asked for by: line-3\n" in said


def test_the_status_says_nothing_of_what_was_answered_meanwhile(
    in_process: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    _connected(monkeypatch, Waiting(None))
    done = in_process("status")
    assert done.returncode == 0 and "waits" not in done.stdout


def test_it_says_where_the_thing_will_be_laid(in_process: Run, cell: Waiting, types: Types) -> None:
    types("n\n")
    for place, said in (("left", "laid at left (0.34, 0.45)"), ("", "laid at (0.34, 0.45)")):
        cell.waits = _proposal().model_copy(update={"place": place, "place_m": np.array([0.34, 0.45, 0.12])})
        assert f"6.2 s of motion, {said}; an answer counts for" in in_process("approve").stderr
        assert said in in_process("status").stdout


def test_a_grasp_on_nothing_that_has_a_name_is_told_by_its_place() -> None:
    assert _proposal("").in_words == "grasp 3 at (0.42, -0.16), score 0.87, 6.2 s of motion"
