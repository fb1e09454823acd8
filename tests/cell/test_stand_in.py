"""One whole cycle of the lab's drivers, each against its stand-in: through the SDKs, recorded, replayed.

The arm's own reflex says that this machine was late: it is raised as itself, and the test is tried again.
"""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from bus.codes import Code
from bus.errors import ArmReflex
from bus.messages import CycleResult
from cell.replay.replay import Request, replay
from logs.mcap.reader import read_cycle
from stand_ins.cell import STATION, stand_ins
from stand_ins.femto_mega.process import no_extensions
from stand_ins.franka import missing

pytestmark = pytest.mark.realtime
PATIENT = ("bus.stale_s=20", "bus.frozen_s=30", "bus.silence_s=5", "bus.ask_timeout_s=30",
           "femto_mega.lost_after_s=20", "camera.max_age_s=20")  # fmt: skip
"""Nine processes share this machine with whatever else it does; none of them is lost because it waits for its turn."""
_STOPPED_ITSELF = "The arm stopped itself"  # during the reset, before there is a result with a code


@pytest.fixture
def cycle(endpoint: str, tmp_path: Path) -> tuple[CycleResult, str]:
    """The result of one cycle that failed, and what its processes said beside."""
    why = missing()
    if why is not None:
        pytest.skip(f"no FR3: {why}")
    no_extensions()
    settings = (f"bus.endpoint={endpoint}", f"recording.folder={tmp_path}", "arm.speed=0.4", *PATIENT)
    command = [sys.executable, "-m", "cell", "start", "--config", str(STATION), "--cycles", "1", "--json"]
    for setting in settings:
        command += ["--set", setting]
    with ExitStack() as stack:
        stand_ins(stack, endpoint)
        ended = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    said = [json.loads(line) for line in ended.stdout.splitlines()]
    if any(line["code"] == Code.ARM_REFLEX for line in said) or (not said and _STOPPED_ITSELF in ended.stderr):
        raise ArmReflex(f"This machine was late: {ended.stdout} {ended.stderr}")
    assert ended.returncode == 1 and said and "result" in said[-1], f"{ended.stdout}\n{ended.stderr}"
    return CycleResult.model_validate(said[-1]), ended.stderr


def test_every_stage_runs_and_fingers_that_closed_on_air_are_a_missed_grasp(cycle: tuple[CycleResult, str]) -> None:
    result, beside = cycle
    assert (result.result, result.code) == ("FAILED", "GRASP_MISSED"), f"{result.reason}\n{beside}"
    assert set(result.stages) >= {"capture", "detect", "plan", "execute", "verify"}
    record = read_cycle(Path(result.recording))
    assert record.result is not None and record.result.code == "GRASP_MISSED"
    assert replay(read_cycle(Path(result.recording)), Request()).equal
