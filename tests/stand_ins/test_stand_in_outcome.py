"""How a cell of stand-ins ends: fingers that close on air are right there, and nothing else that fails is."""

from __future__ import annotations

from pathlib import Path

import pytest

from logs.mcap.recorder import Recorder
from stand_ins.cell import judged, recorded


@pytest.mark.parametrize(
    ("status", "codes", "exit_code"),
    [
        (1, ["GRASP_MISSED"], 0),
        (1, ["GRASP_MISSED", "GRASP_MISSED"], 0),
        (1, ["GRASP_MISSED", "NO_GRASP"], 1),
        (1, [], 1),
        (2, ["GRASP_MISSED"], 2),
        (0, [""], 0),
    ],
)
def test_only_a_grasp_of_air_is_right(
    status: int, codes: list[str], exit_code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert judged(status, codes) == exit_code
    assert ("is right here" in capsys.readouterr().out) == (status == 1 and exit_code == 0)


def test_recordings_are_found_where_the_arguments_say(tmp_path: Path) -> None:
    arguments = ["--cycles", "1", "--set", f"recording.folder={tmp_path}", "--set", "arm.speed=0.4"]
    assert recorded([*arguments, "--set", f"recording.folder={tmp_path / 'none'}"]) == set()
    path = Recorder(tmp_path / "20260101T080000000.mcap", metadata={}, clock=lambda: 1).close({})
    assert recorded(arguments) == {path}
