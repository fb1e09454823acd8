"""The spending ledger: no power cut keeps a cell from its start, and nothing whole is lost."""

from __future__ import annotations

import json
import logging
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.codes import Code
from bus.errors import CycleFailure, RecordingError
from config.perception import HostedSettings
from perception.models.budget import Budget
from perception.models.ledger import Ledger

NOON = datetime(2026, 11, 23, 12, tzinfo=UTC)
TODAY = NOON.date()
LINE = b'{"at": "2026-11-23T12:00:00+00:00", "model": "m", "usd": 0.25}\n'


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "spend.jsonl"


@pytest.mark.parametrize("torn", [LINE[:20], b"\0" * 4096, b'{"at": "2026-11-23', b"\xff\xfe{"])
def test_a_torn_last_line_is_set_aside_and_told(path: Path, torn: bytes, caplog: pytest.LogCaptureFixture) -> None:
    path.write_bytes(LINE + torn)
    ledger = Ledger(path)
    assert ledger.spent_on(TODAY) == 0.25
    assert "power cut" in caplog.text
    assert path.with_name("spend.jsonl.torn").read_bytes() == torn + b"\n"
    ledger.note(NOON, "m", 0.5)
    assert Ledger(path).spent_on(TODAY) == 0.75
    assert [json.loads(line)["usd"] for line in path.read_text().splitlines()] == [0.25, 0.5]


def test_a_last_line_without_its_end_counts_when_it_is_whole(path: Path) -> None:
    path.write_bytes(LINE.rstrip())
    Ledger(path).note(NOON, "m", 0.5)
    assert Ledger(path).spent_on(TODAY) == 0.75


@pytest.mark.parametrize(
    ("damage", "counts_usd"),
    [
        (b"\0\0\0" + LINE, 0.25),
        (LINE.rstrip() + LINE, 0.5),
        (b"garbage\n", 0.0),
        (b'{"model": "m", "usd": 0.125, "a\n', 0.125),
        (b'{"at": "2026-11-22T12:00:00+00:00", "usd": 0.125, "a\n', 0.0),
        (b'{"at": "2026-11-23T12:00:00+00:00", "usd": NaN}\n', 0.0),
        (b'{"at": 1, "usd": true}\n[1]\nnull\n"text"\n', 0.0),
        (b"[" * 100_000 + b"\n", 0.0),
    ],
)
def test_damage_between_lines_counts_what_can_be_read_in_it(path: Path, damage: bytes, counts_usd: float) -> None:
    path.write_bytes(LINE + damage + LINE)
    assert Ledger(path).spent_on(TODAY) == 0.5 + counts_usd


@given(garbage=st.binary(max_size=200))
@settings(max_examples=100, deadline=None)
def test_no_garbage_keeps_a_cell_from_its_start(tmp_path_factory: pytest.TempPathFactory, garbage: bytes) -> None:
    path = tmp_path_factory.mktemp("ledger") / "spend.jsonl"
    path.write_bytes(LINE + garbage)
    logging.disable(logging.WARNING)
    try:
        assert Ledger(path).spent_on(TODAY) >= 0.25
    finally:
        logging.disable(logging.NOTSET)


def test_two_that_write_at_once_leave_whole_lines(path: Path) -> None:
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: Ledger(path).note(NOON, "m" * 200, 0.01), range(40)))
    assert len(path.read_text().splitlines()) == 40
    assert Ledger(path).spent_on(TODAY) == pytest.approx(0.4)


def test_a_ledger_that_cannot_be_read_is_told(path: Path) -> None:
    path.mkdir()
    with pytest.raises(RecordingError, match="spending ledger"):
        Ledger(path)


def test_a_late_payment_is_booked_in_the_cycle_and_on_the_day_it_began_in(path: Path) -> None:
    clock = [NOON.replace(hour=23, minute=59)]
    budget = Budget(HostedSettings(max_cycle_usd=1.0, max_day_usd=5.0), path, lambda: clock[0])
    cycle, began = budget.cycle, clock[0]
    clock[0] += timedelta(minutes=2)
    budget.begin()
    budget.pay("m", 6.0, cycle, began)
    budget.require()
    assert Ledger(path).spent_on(began.date()) == 6.0 and Ledger(path).spent_on(clock[0].date()) == 0.0
    budget.pay("m", 1.0)
    with pytest.raises(CycleFailure, match="this cycle") as refusal:
        budget.require()
    assert refusal.value.failure is Code.SPEND_LIMIT
