"""The real ``lerobot`` opens what `cell export lerobot` writes; in an environment of its own (`just lerobot`)."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.lerobot_reader import ABSENT, is_there, opened
from logs.catalogue import open_catalogue
from logs.export import export_lerobot, select
from logs.export.rolling import Limits
from logs.mcap.reader import read_cycle

parquet = pytest.importorskip("pyarrow.parquet")
pytestmark = [pytest.mark.thorough, pytest.mark.skipif(not is_there(), reason=ABSENT)]
GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.mark.parametrize("limits", [Limits(), Limits(data_bytes=1, video_bytes=1)], ids=["one file", "many files"])
def test_lerobot_gives_the_frames_that_were_recorded(limits: Limits, tmp_path: Path) -> None:
    names = ["cycle-schema2", "cycle-schema4"]
    (tmp_path / "recordings").mkdir()
    for name in names:
        shutil.copy(GOLDEN / f"{name}.mcap", tmp_path / "recordings")
    with open_catalogue(tmp_path / "recordings") as catalogue:
        done = export_lerobot(select(catalogue), tmp_path / "set", lambda paths, _total: paths, limits=limits)
    frames = done.counts["frames"]
    tables = [parquet.read_table(path) for path in sorted((tmp_path / "set/data").rglob("*.parquet"))]
    states = [state for table in tables for state in table["observation.state"].to_pylist()]
    first = tables[0].num_rows if len(tables) > 1 else tables[0]["episode_index"].to_pylist().count(0)

    said = opened(tmp_path / "set", [0, first - 1, first, frames - 1])

    assert (said["frames"], said["episodes"], said["tasks"]) == (frames, 2, ["pick the object"])
    records = [read_cycle(GOLDEN / f"{name}.mcap") for name in names]
    looks = [look for record in records for look in (record.looks[0], record.after)]
    for frame, index, look in zip(said["read"], [0, first - 1, first, frames - 1], looks, strict=True):
        assert look is not None
        assert frame["state"] == pytest.approx(states[index])
        assert frame["color"] == pytest.approx(np.mean(look.frame.color, (0, 1)) / 255, abs=0.01)
    assert [frame["episode"] for frame in said["read"]] == [0, 0, 1, 1]
