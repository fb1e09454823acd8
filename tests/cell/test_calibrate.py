"""``cell calibrate`` in the simulated cell, whose camera does not sit where the station file says."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell.hand_eye_survey import moved
from config.load import load_station
from drivers.sim.optics import hand_from_cameras
from planning.robot import hand_from_color


@pytest.fixture(scope="module")
def station_file(tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]) -> Path:
    path = tmp_path_factory.mktemp("station") / "cell.toml"
    path.write_text(f"""# a cell of ours
[bus]
endpoint = "{new_endpoint()}"

[nodes.sim]
driver = "sim"
serves = ["camera", "arm", "hand"]

[sim]
board = true
seed = 1
mounting_error_mm = 15.0
mounting_error_deg = 3.0
""")
    return path


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.thorough
def test_check_finds_it_wrong_hand_eye_sets_it_right_and_check_is_content(station_file: Path, in_process: Run) -> None:
    def calibrate(verb: str, file: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        return in_process("calibrate", verb, "--config", str(file), *arguments)

    before = calibrate("check", station_file)
    assert before.returncode == 1 and "run `cell calibrate hand-eye`" in before.stdout, before.stderr
    assert "the depth of the looks disagrees by" in before.stdout
    true_pose = hand_from_cameras(load_station(station_file))["color"]

    found = calibrate("hand-eye", station_file)
    assert found.returncode == 0, found.stderr
    assert "view 15 of 15: 24 corners" in found.stdout and "px root mean square" in found.stdout
    text = station_file.read_text()
    assert text.startswith("# a cell of ours\n") and "# calibrated 20" in text
    off_mm, off_deg = moved(true_pose, hand_from_color(load_station(station_file).camera))
    assert off_mm < 1.0 and off_deg < 0.2

    # the simulated error is relative to what the file says: what was found is now the truth
    settled = text.replace("mounting_error_mm = 15.0", "").replace("mounting_error_deg = 3.0", "")
    station_file.write_text(settled)
    after = calibrate("check", station_file, "--json")
    assert after.returncode == 0, after.stderr
    seen = json.loads(after.stdout)
    assert seen["ok"] and seen["off_px"] < 0.5 and abs(seen["depth_off_mm"]) < 15
    assert seen["disagree_after_mm"] <= seen["disagree_mm"] < 2.0


def test_the_board_is_drawn_to_scale(tmp_path: Path, in_process: Run) -> None:
    output = tmp_path / "board.png"
    drawn = in_process("calibrate", "board", "-o", str(output))
    assert drawn.returncode == 0 and "280 x 200 mm" in drawn.stdout
    assert np.asarray(cv2.imread(str(output))).shape == (2000, 2800, 3)
