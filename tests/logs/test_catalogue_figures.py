"""Cycles summed up: each figure is what its definition says."""

from __future__ import annotations

from pathlib import Path

import pytest

from logs.catalogue import summary
from logs.catalogue.columns import NAMES
from logs.catalogue.figures import DEFINITIONS, Counts
from logs.catalogue.opening import open_store
from logs.catalogue.update import listing, update

ID = "2026010{day}T12000000{n}"
CYCLES = (
    # day, result, code, retried_as, wall_s, executed, held, stops, aborts, holds
    (1, "SUCCESS", "", "", 10.0, 1, 1, 0, 0, 0),
    (1, "FAILED", "GRASP_MISSED", "the next", 10.0, 1, 0, 0, 0, 0),
    (1, "SUCCESS", "", "", 10.0, 1, 1, 0, 0, 1),
    (1, "FAILED", "NO_GRASP", "", 4.0, 0, None, 0, 0, 0),
    (1, "EMPTY", "", "", 2.0, 0, None, 0, 0, 0),
    (2, "FAILED", "DROPPED", "", 9.0, 1, 0, 0, 0, 0),
    (2, "ABORTED", "STOPPED", "", 5.0, 0, None, 1, 0, 0),
    (2, "DAMAGED", "", "", None, None, None, None, None, None),
    (2, "UNFINISHED", "", "", None, 0, None, 0, 0, 0),
)
_TAKEN = ("day", "result", "code", "retried_as", "wall_s", "executed", "held", "stops", "aborts", "holds")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Recordings whose rows are those above; the files themselves are empty."""
    rows = []
    for number, (day, *values) in enumerate(CYCLES):
        of = dict(zip(_TAKEN, (f"2026-01-0{day}", *values), strict=True))
        path = tmp_path / f"2026-01-0{day}" / f"{number}.mcap"
        path.parent.mkdir(exist_ok=True)
        path.touch()
        said = path.stat()
        of |= {"file": f"{path.parent.name}/{path.name}", "folder": path.parent.name, "name": path.name}
        of |= {"bytes": 0, "mtime_ns": said.st_mtime_ns, "cycle_id": str(number), "cost_usd": 0.5}
        rows.append([of.get(name) for name in NAMES])
    store = open_store(tmp_path)
    store.put(rows)
    assert update(store, listing(store)) == 0
    store.close()
    return tmp_path


def test_all_cycles_are_summed_up(folder: Path) -> None:
    said = summary(folder).to_json()
    assert {key: said[key] for key in ("cycles", "picks", "empty", "executed")} == {
        "cycles": 6, "picks": 5, "empty": 1, "executed": 4,
    }  # fmt: skip
    assert said["success"] == 0.4 and said["attempts_per_pick"] == 1.2
    assert (said["missed"], said["dropped"], said["multi_pick"], said["infeasible"]) == (0.25, 0.25, 0.0, 0.2)
    assert said["picks_per_hour"] == 3600 * 2 / 50
    assert said["interventions"] == {"stops": 1, "aborts": 0, "holds": 1} and said["picks_between_stops"] == 5.0
    assert said["lost_s"] == {"GRASP_MISSED": 10.0, "DROPPED": 9.0, "STOPPED": 5.0, "NO_GRASP": 4.0}


def test_each_day_has_its_own_figures_the_newest_first(folder: Path) -> None:
    days = summary(folder).days
    assert list(days) == ["2026-01-02", "2026-01-01"]
    assert days["2026-01-01"].to_json() == summary(folder, "2026-01-01").total.to_json()
    assert summary(folder / "2026-01-02").total == days["2026-01-02"]
    assert summary(folder, "2025").total == Counts()


def test_figures_of_nothing_are_none_and_not_zero() -> None:
    said = Counts().to_json()
    assert [said[key] for key in ("success", "picks_per_hour", "missed", "picks_between_stops")] == [None] * 4


def test_every_rate_is_defined() -> None:
    said = set(Counts().to_json()) - {"empty", "interventions", "busy_s", "codes", "cost_usd"}
    assert said == set(DEFINITIONS) - {"stops, aborts, holds"}


def test_a_share_is_rounded_once_so_that_whoever_shows_it_shows_the_same() -> None:
    assert Counts(picks=11, succeeded=6).to_json()["success"] == 0.545  # 54.5 %, and not 54.55 % rounded again
