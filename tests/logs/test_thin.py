"""A trimmed recording: everything but its pictures, as it was recorded."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from bus.errors import RecordingError
from bus.messages import Detections
from logs.catalogue.rows import values_of
from logs.mcap.reader import read_cycle, read_stages
from logs.mcap.thin import thin
from logs.report.cycle_report import write_report

Record = Callable[..., Path]
AT_NS = 1_800_000_000 * 10**9


def test_a_trimmed_recording_is_smaller_and_says_the_same(record: Record) -> None:
    path = record()
    before, row, was = path.stat(), values_of(read_stages(path)), read_cycle(path)
    freed = thin(path, AT_NS, "s3://there/it.mcap", "0" * 64)
    assert path.stat().st_size == before.st_size - freed < before.st_size
    assert path.stat().st_mtime_ns == before.st_mtime_ns, "its page is still current"
    assert values_of(read_stages(path)) == row | {"trimmed": 1, "archived": "s3://there/it.mcap"}
    now = read_cycle(path)
    assert (now.result, now.attempt, now.states, now.hand) == (was.result, was.attempt, was.states, was.hand)
    assert now.looks == () and now.after is None
    assert now.trimmed == "trimmed on 2027-01-15; whole at s3://there/it.mcap"


def test_outlines_stay_and_a_grey_picture_of_the_same_size_stands_for_each(record: Record) -> None:
    path = record()
    was = read_cycle(path).stages["detect"].result
    thin(path, AT_NS)
    now = read_cycle(path).stages["detect"].result
    assert isinstance(was, Detections) and isinstance(now, Detections)
    assert now.evidence.color.shape == was.evidence.color.shape and (now.evidence.color == 128).all()
    assert (now.evidence.object_mask == was.evidence.object_mask).all()
    assert (now.evidence.observed_points == was.evidence.observed_points).all()


@pytest.mark.parametrize("kind", [{}, {"failed": "detect"}, {"failed": "plan"}, {"again": "NO_GRASP", "found": True}])
def test_its_page_can_still_be_written(record: Record, tmp_path: Path, kind: dict[str, str]) -> None:
    path = record(**kind)
    thin(path, AT_NS)
    page = write_report(read_cycle(path), tmp_path / "page.html").read_text()
    assert "Pictures were trimmed on 2027-01-15; nowhere whole" in page


def test_what_cannot_be_trimmed_is_as_it_was(record: Record) -> None:
    path = record()
    damaged = path.read_bytes()[:-100]
    path.write_bytes(damaged)
    with pytest.raises(RecordingError):
        thin(path, AT_NS)
    assert path.read_bytes() == damaged and os.listdir(path.parent) == [path.name]
