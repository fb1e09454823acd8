"""A pick that waited in the queue has the id of when it was asked for; its recording says when it began, too."""

from __future__ import annotations

from pathlib import Path

from cell.daemon.actions import new_cycle_id, recording_path
from cell.daemon.runinfo import run_info
from config.load import load_station
from logs.mcap.index import BEGAN

ASKED_AT = "20260101T235959000"


def test_a_recording_says_when_its_cycle_began() -> None:
    before = new_cycle_id()
    said = run_info(load_station(), ASKED_AT)
    assert said["cycle_id"] == ASKED_AT < before <= said[BEGAN] <= new_cycle_id()


def test_a_recording_lies_in_the_folder_of_its_ids_day_whenever_it_began() -> None:
    assert recording_path(Path("recordings"), ASKED_AT) == Path("recordings/2026-01-01/20260101T235959000.mcap")
