"""The page of the day while the cell runs: soon after a cycle, but never for more than a fiftieth of the time."""

from __future__ import annotations

from pathlib import Path

from cell.cli.serving.day_page import DayPage

MONDAY, TUESDAY = Path("2026-11-30/a.mcap"), Path("2026-12-01/b.mcap")


class Clock:
    """Writing a page takes two seconds of it."""

    def __init__(self) -> None:
        self.now_s, self.pages = 0.0, list[str]()

    def __call__(self) -> float:
        return self.now_s

    def write(self, day: Path) -> Path:
        self.now_s += 2.0
        self.pages.append(day.name)
        return day


def test_it_is_written_when_there_is_time_and_rests_fifty_times_as_long_as_that_took() -> None:
    clock = Clock()
    page = DayPage(clock.write, clock)
    page.turn()
    page.written(MONDAY)
    assert clock.pages == []
    page.turn()
    page.written(MONDAY)
    page.turn()
    assert clock.pages == ["2026-11-30"]
    clock.now_s += 100.0
    page.turn()
    page.turn()
    assert clock.pages == ["2026-11-30"] * 2


def test_the_day_that_has_ended_and_the_last_cycle_are_not_left_out() -> None:
    clock = Clock()
    page = DayPage(clock.write, clock)
    page.written(MONDAY)
    page.written(TUESDAY)
    assert clock.pages == ["2026-11-30"]
    page.close()
    page.close()
    assert clock.pages == ["2026-11-30", "2026-12-01"]
