"""A pick by a pixel, a box, words, into a named place and a position, by the documented client of every protocol."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

pytest.importorskip("asyncua")  # the extra `opcua`

from cell.build import running_cell
from cell.client import connect
from cell.replay.replay import Request, replay
from config.load import load_station
from docs.examples.pixel import pixel_of
from logs.mcap.reader import read_cycle
from tests.cell.http_bench import served_for_real
from tests.cell.opcua_bench import serving

pytestmark = [pytest.mark.thorough, pytest.mark.xdist_group("opcua")]
DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = DOCS / "examples"
JOBS = (
    "orange",  # the cup's pixel, found in the picture that the protocol gives
    '{"job_id": "box", "target": {"box": [500, 220, 760, 370]}, "place": {"name": "left"}}',
    '{"job_id": "words", "target": {"text": "the largest"}, "place": {"position_m": [0.46, 0.45, 0.14]}}',
)


@contextmanager
def _serving(protocol: str, endpoint: str, door: str, folder: Path) -> Iterator[list[str]]:
    """A cell with three things on its table, served; the client's command line, without its job."""
    place = 'scene.places=[{name="left",position_m=[0.34,0.45,0.12]}]'
    settings = [f"bus.endpoint={endpoint}", f"opcua.endpoint=opc.{door}/cell", f"recording.folder={folder}"]
    station = load_station(None, [*settings, "sim.clutter=3", "sim.seed=3", place])
    with running_cell(station, lambda topic, message: None), ExitStack() as stack:
        if protocol == "http":
            yield ["http_client.py", stack.enter_context(served_for_real(station))]
        elif protocol == "opcua":
            yield ["opcua_client.py", stack.enter_context(serving(station))]
        else:
            yield ["trigger.py", station.cell_id]


@pytest.mark.parametrize("protocol", ["zenoh", "opcua", "http"])
def test_whatever_a_client_speaks_it_names_what_and_where(
    protocol: str, new_endpoint: Callable[[], str], tmp_path: Path
) -> None:
    bus, door = new_endpoint(), new_endpoint().replace("tcp/", "tcp://")
    programs, recordings = tmp_path / "programs", tmp_path / "recordings"
    programs.mkdir()
    for source in EXAMPLES.glob("*.py"):
        (programs / source.name).write_text(source.read_text().replace("tcp/127.0.0.1:7447", bus))
    with _serving(protocol, bus, door, recordings) as (program, where):
        for job in JOBS:
            command = [sys.executable, str(programs / program), where, job]
            done = subprocess.run(command, capture_output=True, text=True, timeout=120)
            assert done.returncode == 0, done.stderr
            assert "'result': 'SUCCESS'" in done.stdout, done.stdout
    cycles = [read_cycle(path) for path in sorted(recordings.rglob("*.mcap"))]
    results = [cycle.result for cycle in cycles if cycle.result is not None]
    assert [result.object for result in results] == ["cup", "controller", "spatula"]
    targets = [result.job.target for result in results if result.job.target is not None]
    assert [target.pixel is not None for target in targets] == [True, False, False]
    assert [result.laid.place for result in results if result.laid is not None] == ["", "left", ""]
    assert all(replay(cycle, Request()).equal for cycle in cycles)


def test_the_pixel_on_the_pages_is_the_one_that_their_commands_find(endpoint: str, tmp_path: Path) -> None:
    station = load_station(None, [f"bus.endpoint={endpoint}", f"recording.folder={tmp_path}", "sim.clutter=3"])
    with running_cell(station, lambda topic, message: None), connect(station) as cell:
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)
        pixel = list(pixel_of(cell.picture().data, "orange"))
    for page in ("http.md", "opcua.md"):
        assert f'{{"pixel": {pixel}' in (DOCS / page).read_text(), f"{page}: {pixel}"
