"""One whole cycle of the lab's drivers, each against its stand-in: through the SDKs, recorded, replayed."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from bus.errors import ArmReflex
from bus.messages import CycleResult
from cell.replay import replay_file
from logs.reader import read_cycle
from tests.stand_ins.cell import STATION, stand_ins
from tests.stand_ins.femto_mega.process import no_extensions
from tests.stand_ins.franka import missing

pytestmark = pytest.mark.realtime


@pytest.fixture
def cycle(endpoint: str, tmp_path: Path) -> tuple[int, dict[str, Any]]:
    """Exit code and result of one cycle."""
    why = missing()
    if why is not None:
        pytest.skip(f"no FR3: {why}")
    no_extensions()
    settings = (f"bus.endpoint={endpoint}", f"recording.folder={tmp_path}")
    command = [sys.executable, "-m", "cell", "start", "--config", str(STATION), "--cycles", "1", "--json"]
    for setting in settings:
        command += ["--set", setting]
    with ExitStack() as stack:
        stand_ins(stack, endpoint)
        ended = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    said = [json.loads(line) for line in ended.stdout.splitlines()]
    if "The arm stopped itself" in ended.stdout + ended.stderr:
        raise ArmReflex(f"This machine was late: {ended.stdout} {ended.stderr}")
    assert said, ended.stderr
    return ended.returncode, said[-1]


def test_every_stage_runs_and_fingers_that_closed_on_air_are_a_missed_grasp(cycle: tuple[int, dict[str, Any]]) -> None:
    code, said = cycle
    result = CycleResult.model_validate(said)
    assert (code, result.result, result.code) == (1, "FAILED", "GRASP_MISSED"), result.reason
    assert set(result.stages) >= {"capture", "detect", "plan", "execute", "verify"}
    record = read_cycle(Path(result.recording))
    assert record.result is not None and record.result.code == "GRASP_MISSED"
    assert replay_file(Path(result.recording), []).equal
