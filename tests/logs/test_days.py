"""Pages of a folder: written once, and again when they must be; a day's page hides nothing and leads with failures."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from bus.errors import RecordingError
from logs.report.day_report import INDEX, days, outdated, write_cycle, write_day

Record = Callable[..., Path]
MORNING, NOON, EVENING = "20260101T080000000", "20260101T120000000", "20260101T200000000"


def _write(folder: Path) -> str:
    for path in outdated(folder):
        write_cycle(path)
    (day,) = days(folder)
    return write_day(day).read_text()


def test_failures_come_first_and_each_leads_to_its_page(record: Record, tmp_path: Path) -> None:
    for name, failed in ((MORNING, None), (NOON, "plan"), (EVENING, None)):
        record(failed, name)
    page = _write(tmp_path)
    assert re.findall(r'href="(\w+)\.html"', page) == [NOON, EVENING, MORNING]
    assert all((tmp_path / f"{name}.html").exists() for name in (MORNING, NOON, EVENING))
    assert "<h1>2026-01-01" in page and "NO_GRASP" in page and "Lay it so that" in page
    assert page.count('src="data:image/jpeg') == 3


def test_a_day_is_told_in_numbers_by_the_hour_and_can_be_filtered(record: Record, tmp_path: Path) -> None:
    for name, failed in ((MORNING, None), (NOON, "plan"), (EVENING, None)):
        record(failed, name)
    page = _write(tmp_path)
    assert "2 of 3 picks succeeded: 67 %, 95 % interval 21 % to 94 %" in page
    assert re.findall(r'title="(\d\d):00 UTC: (\d) of (\d)"', page)[::4] == [
        ("08", "1", "1"), ("12", "0", "1"), ("16", "0", "0"), ("20", "1", "1")
    ]  # fmt: skip
    assert '<option value="NO_GRASP">NO_GRASP (1)</option>' in page
    assert re.findall(r'data-code="(\w*)"', page) == ["NO_GRASP", "", ""]


def test_pages_are_for_those_who_may_read_the_recordings(record: Record, tmp_path: Path) -> None:
    path = record(None, MORNING)
    _write(tmp_path)
    for page in (path.with_suffix(".html"), tmp_path / INDEX):
        assert page.stat().st_mode & 0o777 == path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    "summary", ['{"stages": {"plan": "long"}, "why": 5, "thumbnail": [1]}', '{"stages": [1]}', "[" * 20_000]
)
def test_what_stands_in_a_pages_head_is_not_believed(record: Record, tmp_path: Path, summary: str) -> None:
    page = record(None, MORNING).with_suffix(".html")
    page.write_text(f'<script id="summary" type="application/json">{summary}</script>')
    assert "1 cycle<" in write_day(tmp_path).read_text()


def test_stage_times_are_those_of_every_cycle_that_came_so_far(record: Record, tmp_path: Path) -> None:
    record(None, MORNING)
    record("detect", NOON)
    page = _write(tmp_path)
    dots = {name: spread.count("<circle") for name, spread in re.findall(r'aria-label="(\w+) times">(.*?)</svg>', page)}
    assert dots == {"capture": 2, "detect": 2, "plan": 1, "execute": 1, "verify": 1}


def test_a_page_is_written_again_only_when_it_is_older_or_of_another_kind(record: Record, tmp_path: Path) -> None:
    first, second = record(None, MORNING), record(None, NOON)
    _write(tmp_path)
    assert outdated(tmp_path) == []
    os.utime(first, ns=(first.stat().st_mtime_ns + 10**9 * 60,) * 2)
    assert outdated(tmp_path) == [first]
    page = second.with_suffix(".html")
    page.write_text(page.read_text().replace(f" {INDEX}", " ", 1))
    assert outdated(tmp_path) == [second, first]


def test_what_cannot_be_read_is_on_the_days_page_with_its_reason(record: Record, tmp_path: Path) -> None:
    record(None, MORNING)
    damaged = record(None, NOON)
    damaged.write_bytes(damaged.read_bytes()[:100])
    (tmp_path / f"{EVENING}.mcap.part").write_bytes(b"")
    page = _write(tmp_path)
    assert "TORN" in page and "cell recover" in page and "DAMAGED" in page
    assert re.findall(r'href="(\w+)\.html"', page) == [MORNING]


def test_a_page_of_ours_that_somebody_else_wrote_is_no_trouble(record: Record, tmp_path: Path) -> None:
    path = record(None, MORNING)
    for head in ("", "<html>", '<script id="summary" type="application/json">[1]</script>'):
        path.with_suffix(".html").write_text(head)
        assert outdated(tmp_path) == [path]
        assert "1 cycle<" in write_day(tmp_path).read_text()


def test_a_folder_without_recordings_is_said_to_have_none(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no recording in"):
        days(tmp_path)
