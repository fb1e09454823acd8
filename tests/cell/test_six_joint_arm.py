"""The simulated cell with an arm of six joints: examples/six_joint_arm."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import vlad_cell
from bus.errors import MotionRefused
from bus.trajectory import Trajectory
from cell.replay.replay import Request, replay
from config.load import load_station
from drivers.node.guard import Guard
from drivers.node.registry import open_devices
from logs.catalogue.rows import values_of
from logs.mcap.reader import read_cycle
from logs.report.cycle_report import write_report
from vlad_cell.testing import ArmSuite, HandSuite

STATION_FILE = Path(__file__).parents[2] / "examples" / "six_joint_arm" / "station.toml"


def test_the_guard_refuses_a_motion_of_another_arm() -> None:
    station = load_station(STATION_FILE)
    arm = open_devices("sim", station).arm
    assert arm is not None
    guard = Guard(arm, station)
    guard.connect()
    with pytest.raises(MotionRefused, match="has 7 joints, and the arm of the station 6"):
        guard.execute(Trajectory(raw_q_rad=np.zeros((1, 7)), window=1))


@pytest.mark.thorough
class TestArm(ArmSuite):
    """What every arm does."""

    name = "sim"
    station_file: ClassVar[Path | None] = STATION_FILE


@pytest.mark.thorough
class TestHand(HandSuite):
    """What every hand does."""

    name = "sim"
    station_file: ClassVar[Path | None] = STATION_FILE


@pytest.mark.thorough
@pytest.mark.parametrize("more", [(), ("sim.clutter=4",)], ids=["one object", "four objects"])
def test_it_picks_and_its_recording_replays_to_the_last_bit(tmp_path: Path, endpoint: str, more: Sequence[str]) -> None:
    overrides = (f"bus.endpoint={endpoint}", "verify.hold_s=0.5", *more)
    command = [sys.executable, "-m", "cell", "start", "--config", str(STATION_FILE), "--cycles", "2", "--seed", "1"]
    run = subprocess.run(
        [*command, "--json", *(word for one in overrides for word in ("--set", one))],
        cwd=tmp_path, capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    results = [json.loads(line) for line in run.stdout.splitlines()]
    assert [one["result"] for one in results] == ["SUCCESS", "SUCCESS"], run.stderr
    for one in results:
        record = read_cycle(tmp_path / one["recording"])
        assert replay(record, Request()).equal
        arm = vlad_cell.read_cycle(tmp_path / one["recording"]).joints
        assert arm.q_rad.shape == arm.tau_ext_nm.shape == (len(arm.time_s), 6)
        row = values_of(record)
        assert row["joint_nearest"] in range(1, 7) and isinstance(row["joint_margin_rad"], float)
        page = write_report(record, tmp_path / "report.html").read_text()
        assert "joint 6" in page and "joint 7" not in page
