"""``vlad_cell.Cell`` on one simulated cell: what it commands, the programs of docs/examples, and the notebook."""

from __future__ import annotations

import json
import re
import runpy
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vlad_cell
from bus.commands import CellState
from bus.errors import BusError
from docs import notebook
from vlad_cell import (
    Cell,
    CellUnreachable,
    ConfigError,
    CycleResult,
    RecordingError,
    Refused,
    Target,
    read_cycle,
    simulated_cell,
)

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "examples"
RunExample = Callable[..., str]


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A simulated cell that was reset."""
    folder = tmp_path_factory.mktemp("recordings")
    with simulated_cell(seed=1, folder=folder, settings={"verify.hold_s": 0.5, "capture.views": 1}) as cell:
        cell.reset()
        yield cell


@pytest.fixture
def run_example(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> RunExample:
    """Runs a program of docs/examples with these arguments, in an empty folder; returns what it prints."""

    def run(name: str, *arguments: str) -> str:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_program_of_the_examples_is_run_by_a_test() -> None:
    tests = [file.read_text() for file in (ROOT / "tests").rglob("test_*.py") if file != Path(__file__)]
    own = Path(__file__).read_text()
    for program in [*EXAMPLES.glob("*.py"), *EXAMPLES.glob("*.ipynb")]:
        used = re.compile(rf"{re.escape(program.name)}|docs\.examples\.{program.stem} ")
        assert any(used.search(text) for text in tests) or f'"{program.name}"' in own, program.name


def test_a_pick_goes_on_while_it_is_heard_and_its_recording_is_read(cell: Cell, run_example: RunExample) -> None:
    with Cell(cell.endpoint) as other:
        assert other.station.cell_id == "sim", "the only cell there"
        begun = cell.begin_pick(job_id="mine", deadline_s=3600)
        watched = list(other.events())
    assert repr(other) == f"Cell 'sim' at {cell.endpoint}"
    for use in (other.pick, other.reset, other.state):
        with pytest.raises(BusError, match=r"(?i)this connection is closed"):
            use()
    heard = list(begun)
    assert isinstance(watched[-1], CellState) and watched[-1].state == "Complete"
    states = [said.state for said in heard if isinstance(said, CellState)]
    assert begun.result is heard[-1] and begun.result.result == "SUCCESS" and begun.result.job.job_id == "mine"
    assert "Execute" in states and begun.wait() is begun.result
    told = run_example("read_cycle.py", begun.result.recording)
    assert told.startswith("SUCCESS : Held") and "1 looks; color (720, 1280, 3)" in told and "-> score" in told


def test_the_program_that_picks_joins_a_running_cell(cell: Cell, run_example: RunExample) -> None:
    cell.release()  # one client at a time
    told = run_example("pick_from_python.py", cell.endpoint, "purple")
    assert "Execute detect" in told and "FAILED TARGET_NOT_FOUND Nothing here is 'purple'." in told
    failed = read_cycle(told.splitlines()[-1])
    assert (failed.result, failed.code, failed.grasps, failed.chosen) == ("FAILED", "TARGET_NOT_FOUND", (), None)
    assert failed.color.shape == (720, 1280, 3), "what it saw is there"
    with pytest.raises(RecordingError, match="Nothing was found"):
        failed.picture()


def test_the_program_that_detects_needs_no_cell(run_example: RunExample) -> None:
    assert "the best: at (0.4" in run_example("detect_image.py")


def test_the_notebook_runs_and_gives_what_it_shows(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = json.loads((EXAMPLES / "first_pick.ipynb").read_text())
    monkeypatch.setattr(vlad_cell, "simulated_cell", lambda **_: cell)
    monkeypatch.setattr(cell, "close", lambda: None)
    given = notebook.run(shown, {})
    assert _kinds(given) == _kinds(shown), "run: python -m docs.notebook"
    said = json.dumps(given)
    assert "SUCCESS" in said and "NO_GRASP" in said and "TARGET_NOT_FOUND" in said
    assert _refusal(given) == _refusal(shown), "run: python -m docs.notebook"


def test_the_lines_of_the_readme_pick(
    cell: Cell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert lines is not None
    monkeypatch.setattr(Cell, "simulated", lambda **_: cell)
    monkeypatch.setattr(cell, "close", lambda: None)
    exec(lines[1], {})
    assert capsys.readouterr().out.startswith("SUCCESS Held")


def _refusal(given: dict[str, Any]) -> str:
    """Return what the notebook's detection with too small a hand ends with, without its measures."""
    (said,) = [
        text
        for cell in given["cells"]
        for one in cell.get("outputs", ())
        for text in one.get("text", ())
        if "jaw" in text
    ]
    return re.sub(r"[0-9]+", "#", said)


def _kinds(given: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """Of each cell its id and the kinds of what it gives."""
    cells = given["cells"]
    return [(one["id"], [kind for output in one.get("outputs", []) for kind in _kind(output)]) for one in cells]


def _kind(output: dict[str, Any]) -> list[str]:
    return sorted(output["data"]) if "data" in output else [output["output_type"]]


def _blocks() -> list[str]:
    """The three programs at the head of docs/api.md."""
    return re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "api.md").read_text(), re.DOTALL)[:3]


def test_the_few_lines_of_the_page_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    golden = read_cycle(ROOT / "tests" / "golden" / "cycle-schema4.mcap")
    arrays = {name: getattr(golden, name) for name in ("color", "depth_m", "K", "base_from_camera")}
    np.savez("image.npz", **arrays)
    detects, reads, _ = _blocks()
    exec(detects, {})
    exec(reads.replace("recordings/DAY/CYCLE_ID.mcap", str(golden.path)), {})
    assert Path("grasp.png").is_file()


@pytest.mark.thorough
def test_the_few_lines_that_pick_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    said: dict[str, Any] = {}
    exec(_blocks()[2], said)
    assert said["result"].result == "SUCCESS" and Path(said["result"].recording).is_file()


def test_what_the_cell_does_not_do_now_is_refused_with_the_reason(cell: Cell) -> None:
    with pytest.raises(Refused, match="unhold") as refused:
        cell.unhold()
    assert refused.value.code == "WRONG_STATE" and "reset" in refused.value.available
    with pytest.raises(Refused, match="unicorn") as refused:
        cell.pick(object_name="unicorn")
    assert refused.value.code == "UNKNOWN_OBJECT"
    with pytest.raises(Refused, match="left"):
        cell.pick(place="left")
    for target in (Target(pixel=(1280, 90)), Target(box=(0, 720, 90, 800))):
        with pytest.raises(Refused, match="outside the picture, which has 1280 x 720 pixels") as refused:
            cell.pick(target)
        assert refused.value.code == "BAD_JOB"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"target": ""}, "text"),
        ({"target": (640, 360)}, r"target has 2 numbers.*Target\(pixel="),
        ({"target": 5}, r"target is 5.*Target\(point_m="),
        ({"place": (0.4, 0.4)}, "place has 2 numbers"),
        ({"place": (400, 400, 99.0)}, "position_m.*in metres"),
        ({"place": ("left", 0, 0)}, "place is"),
        ({"deadline_s": -1}, "deadline_s"),
        ({"job_id": "\n"}, "job_id"),
    ],
    ids=str,
)
def test_an_argument_that_cannot_be_is_named_before_anything_is_asked(
    cell: Cell, arguments: dict[str, object], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        cell.pick(**arguments)  # type: ignore[arg-type]


def test_a_number_of_picks_that_cannot_be_is_named(cell: Cell) -> None:
    with pytest.raises(ConfigError, match="cycles"):
        next(cell.picks(0))


def test_a_stop_an_abort_and_a_clear_reach_their_states(cell: Cell) -> None:
    assert cell.stop().state == "Stopped"
    assert cell.abort().state == "Aborted"
    assert cell.clear().state == "Stopped"
    assert cell.reset().state == "Idle" and cell.health().nodes["sim"].is_alive


@pytest.mark.thorough
def test_several_picks_give_a_result_each(cell: Cell) -> None:
    cell.stop()
    cell.reset()
    results = list(cell.picks(2))
    assert [type(one) for one in results] == [CycleResult, CycleResult]
    assert {one.result for one in results} == {"SUCCESS"}


@pytest.mark.thorough
def test_after_ctrl_c_the_cell_holds_and_can_go_on(cell: Cell) -> None:
    def interrupt(line: str) -> None:
        if line == "Execute capture":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cell.pick(progress=interrupt)
    held = next(said for said in cell.events() if isinstance(said, CellState) and said.state in ("Held", "Complete"))
    if held.state == "Held":
        cell.unhold()
        assert [said.state for said in cell.events() if isinstance(said, CellState)][-1] == "Complete"


def test_another_cell_than_the_one_that_was_named_is_no_connection(cell: Cell) -> None:
    with pytest.raises(CellUnreachable, match="cell 'another' does not answer at this address"):
        Cell(cell.endpoint, cell_id="another")


def test_a_cell_that_is_not_there_is_unreachable(new_endpoint: Callable[[], str]) -> None:
    endpoint = new_endpoint()
    with pytest.raises(CellUnreachable, match=re.escape(endpoint)):
        Cell(endpoint)
