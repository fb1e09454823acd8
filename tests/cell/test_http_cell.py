"""A real cell over HTTP: a client in plain Python picks, one that dies leaves the arm held, others are told."""

from __future__ import annotations

import json
import queue
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import httpx2
import pytest

from cell import client
from cell.cli.network.tls_keys import make_keys
from cell.nodes.doors import Door
from config.http import HttpSettings
from config.schema import Station
from logs.mcap.reader import read_cycle
from tests.cell.http_bench import served_for_real

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLE, PAGE = DOCS / "examples" / "http_client.py", DOCS / "http.md"
JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def pace() -> float:
    return 3.0


@pytest.fixture(scope="module")
def url(_shared_here: Station) -> Iterator[str]:
    """Where the shared cell is served."""
    with served_for_real(_shared_here) as address:
        yield address


@pytest.fixture
def http(url: str) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=url, timeout=60, headers=JSON) as http:
        yield http


def _attending(url: str, path: str) -> socket.socket:
    """A client that attends motion with one request, and waits."""
    host, port = url.removeprefix("http://").split(":")
    plug = socket.create_connection((host, int(port)), timeout=60)
    plug.sendall(f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\n\r\n".encode())
    assert plug.recv(12) == b"HTTP/1.1 200"
    return plug


def _example_picks(url: str) -> None:
    done = subprocess.run([sys.executable, "-I", EXAMPLE, url], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "'result': 'SUCCESS'" in done.stdout and "'job_id': 'example'" in done.stdout


def test_the_example_picks_and_what_it_left_is_served(shared_cell: Station, url: str, http: httpx2.Client) -> None:
    _example_picks(url)
    newest = http.get("/api/cycles", params={"limit": 1}).json()[0]
    result = http.get(f"/api/results/{newest['cycle_id']}").json()
    recorded = read_cycle(Path(result["recording"])).result
    assert recorded is not None and result == json.loads(recorded.model_dump_json())
    recording = Path(result["recording"]).read_bytes()
    assert http.get(newest["file"], headers={"Range": "bytes=0-9999"}).content == recording[:10_000]
    give_up_s = time.monotonic() + 120
    while 404 in [http.get(path).status_code for path in ("/api/picture", "/api/scene")]:
        assert time.monotonic() < give_up_s  # Zenoh drops large messages on a busy machine
        _example_picks(url)
    assert http.get("/api/picture").content[:2] == b"\xff\xd8"
    now = http.get("/api/picture/now")  # the cell is Complete
    assert (now.headers["Content-Type"], now.content[:4]) == ("image/png", b"\x89PNG")
    assert int(now.headers["X-Stamp-Ns"]) > 0
    scene = http.get("/api/scene").json()
    assert scene["outlines"] and scene["numbers"]
    with client.connect(shared_cell) as cell:
        cell.command("reset")  # nobody holds the lease any more
        cell.wait_for_state({"Idle"}, 60)


def test_who_dies_in_motion_leaves_the_arm_held_and_meanwhile_others_are_told(
    shared_cell: Station, url: str, http: httpx2.Client
) -> None:
    assert http.post("/api/commands/reset?wait=true").json()["state"] == "Idle"
    with client.connect(shared_cell) as cell:
        plug = _attending(url, "/api/picks?client=doomed")
        while cell.state().stage != "execute":
            cell.next_said(60)
        other = http.post("/api/picks?client=other")
        assert (other.status_code, other.json()["code"]) == (409, "LEASE_HELD")
        assert "http-doomed-" in other.json()["reason"]
        plug.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # a reset, as of a killed process
        plug.close()
        assert "http-doomed-" in cell.wait_for_state({"Held"}, 60).reason
    stopped = http.post("/api/commands/stop", content=b'{"client_id": "line"}')
    assert (stopped.status_code, stopped.json()["state"]) == (200, "Stopping")


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
def test_the_commands_of_the_page_run_in_a_shell(shared_cell: Station, url: str) -> None:
    """All but the picks and the picture for one, which others do in other ways."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("curl") and "/picks" not in line]
    lines = [line for line in lines if "/picture" not in line]
    assert len(lines) == 3
    said = [
        json.loads(subprocess.check_output(["bash", "-c", line.replace("http://127.0.0.1:8088", url)], timeout=60))
        for line in lines
    ]
    assert [one["state"] for one in said] == ["Stopped", "Idle", "Stopping"]
    with client.connect(shared_cell) as cell:
        cell.wait_for_state({"Stopped"}, 60)


def test_the_cell_opens_it_as_a_process_of_its_own_and_closes_it(shared_cell: Station) -> None:
    news: queue.SimpleQueue[tuple[str, ...]] = queue.SimpleQueue()
    station = shared_cell.model_copy(update={"http": HttpSettings(port=0)})
    with closing(Door("http", station, lambda *said: news.put(said)).start()):
        code, _, text, _ = news.get(timeout=60)
        assert code == "DOOR_OPEN"
        there = text.removesuffix(".").rpartition(" ")[2]
        assert httpx2.get(f"{there}/api/state", timeout=60).json()["state"] == "Stopped"
    with pytest.raises(httpx2.ConnectError):
        httpx2.get(f"{there}/api/state")


def test_what_is_not_safe_is_refused_before_anything_starts(
    in_process: Callable[..., subprocess.CompletedProcess[str]], options: list[str], tmp_path: Path
) -> None:
    make_keys(tmp_path / "keys", [])
    settings = ("http.host=0.0.0.0", f"http.certificate={tmp_path}/keys/cell.pem", f"http.key={tmp_path}/keys/cell.key")
    beyond = [word for setting in settings for word in ("--set", setting)]
    for command in (["start", "--http"], ["http"]):
        done = in_process(*command, *options, *beyond)
        assert (done.returncode, "no operator's token" in done.stderr) == (2, True)
    assert "needs TLS" in in_process("http", *options, "--set", "http.host=0.0.0.0").stderr


def test_without_a_cell_it_says_so_and_ends(
    in_process: Callable[..., subprocess.CompletedProcess[str]], options: list[str]
) -> None:
    done = in_process("http", *options, "--set", "http.port=0")
    assert (done.returncode, "UNREACHABLE_CELL" in done.stderr) == (4, True)


def test_without_a_lease_nothing_moves(shared_cell: Station, http: httpx2.Client) -> None:
    refused = http.post("/api/commands/reset")
    assert (refused.status_code, refused.json()["code"]) == (409, "NO_LEASE")
    assert http.post("/api/picks").json()["code"] == "WRONG_STATE"
    with client.connect(shared_cell) as cell:
        assert cell.state().state == "Stopped"
