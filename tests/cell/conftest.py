"""The command line as a user runs it: real processes, a free port, a folder of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bus.errors import BusError
from cell import client
from cell.build import running_cell
from cell.command import main
from cell.terminal.signals import ENDING
from config.load import load_station
from config.schema import Station

Cell = tuple[subprocess.Popen[str], Station]


@pytest.fixture
def options(tmp_path: Path, endpoint: str) -> list[str]:
    """Settings that keep a test's cell away from every other."""
    return _options(endpoint, tmp_path)


@pytest.fixture
def daemon(options: list[str]) -> Iterator[Cell]:
    """A running ``cell start`` at real-time pace, Stopped, and its station: for a test that ends it, or prepares it."""
    with _running(options) as cell:
        yield cell


@pytest.fixture(scope="module")
def pace() -> float:
    """Simulated seconds a second, in the cells that a module's tests share."""
    return 1.0


@pytest.fixture(scope="module")
def shared_options(tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]) -> list[str]:
    """Settings of the cell that a module's tests share."""
    return _options(new_endpoint(), tmp_path_factory.mktemp("shared"))


@pytest.fixture(scope="module")
def _shared(shared_options: list[str], pace: float) -> Iterator[Cell]:
    with _running(shared_options, pace) as cell:
        yield cell


@pytest.fixture
def shared_daemon(_shared: Cell) -> Cell:
    """The cell that a module's tests share, Stopped and with its node, whatever the last one did to it."""
    _stop(_shared[1])
    return _shared


@pytest.fixture(scope="module")
def _shared_here(shared_options: list[str], pace: float) -> Iterator[Station]:
    station = load_station(None, [*shared_options[1::2], f"sim.pace={pace}"])
    with running_cell(station, lambda topic, message: None):
        yield station


@pytest.fixture
def shared_cell(_shared_here: Station) -> Station:
    """Like `shared_daemon`, but its daemon is in the tests' own process: for those that say nothing of it."""
    _stop(_shared_here)
    return _shared_here


def _stop(station: Station) -> None:
    """Until the cell is Stopped and has its node, whatever was done to it."""
    give_up_s = time.monotonic() + 60
    with client.connect(station) as connection:
        while not all(node.is_alive for node in connection.health().nodes.values()):
            assert time.monotonic() < give_up_s
            time.sleep(0.05)
        state = connection.wait_for_state({"Stopped", "Idle", "Execute", "Held", "Complete", "Aborted"}, 60).state
        if state != "Stopped":
            connection.command("clear" if state == "Aborted" else "stop")
            connection.wait_for_state({"Stopped"}, 60)


@pytest.fixture
def in_process(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., subprocess.CompletedProcess[str]]]:
    """Runs ``cell`` with the given arguments in this process: its imports, which take a new one seconds, are made."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        monkeypatch.setattr(sys, "argv", ["cell", *arguments])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        said = capfd.readouterr()
        code = ended.value.code
        return subprocess.CompletedProcess(arguments, code if isinstance(code, int) else 0, said.out, said.err)

    handlers = {number: signal.getsignal(number) for number in ENDING}
    yield run
    for number, handler in handlers.items():
        signal.signal(number, handler)


def _options(endpoint: str, folder: Path) -> list[str]:
    """A loopback endpoint, a folder; and no object is held for longer than the tests need."""
    settings = (f"bus.endpoint={endpoint}", f"recording.folder={folder / 'recordings'}", "verify.hold_s=0.5")
    return [word for setting in settings for word in ("--set", setting)]


@contextmanager
def _running(options: list[str], pace: float = 1.0) -> Iterator[Cell]:
    station = load_station(None, options[1::2])
    process = subprocess.Popen(
        [sys.executable, "-m", "cell", "start", "--no-report", "--set", f"sim.pace={pace}", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _await_state(station)
        yield process, station
    finally:
        process.terminate()
        process.communicate(timeout=60)


def _await_state(station: Station) -> None:
    give_up_s = time.monotonic() + 60
    while True:
        try:
            with client.connect(station) as connection:
                connection.state()
            return
        except BusError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.2)
