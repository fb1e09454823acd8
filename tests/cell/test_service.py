"""The cell as a service: what systemd hears from a real one, and how it ends."""

from __future__ import annotations

import os
import queue
import shutil
import signal
import socket
import sqlite3
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from bus.commands import CellState, CommandRequest
from bus.messages import Execution
from bus.session import Bus
from cell import client
from cell.daemon.systemd import Service, takes_commands
from cell.machine.hold_state import HoldState
from cell.machine.owner import Machine
from config.schema import Station
from drivers.remote import RemoteArm
from logs.catalogue.store import CATALOGUE
from logs.mcap.reader import read_cycle

Cell = tuple[subprocess.Popen[str], Station]
UNIT = Path(__file__).parents[2] / "packaging" / "vlad-cell@.service"
WATCHDOG_S = 2.0


class Systemd:
    """The service manager's end of the socket; reads all the time, because the kernel keeps only a few datagrams."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.heard: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        while (said := self._socket.recv(4096)) != b"":
            for line in said.decode().splitlines():
                self._lines.put(line)

    def wait_for(self, line: str, timeout_s: float = 60.0) -> None:
        """Read on until a line begins with ``line``."""
        give_up_s = time.monotonic() + timeout_s
        while True:
            try:
                self.heard.append(self._lines.get(timeout=max(0.001, give_up_s - time.monotonic())))
            except queue.Empty:
                pytest.fail(f"no {line!r} within {timeout_s} s, but {self.heard}")
            if self.heard[-1].startswith(line):
                return

    def close(self) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
            last.sendto(b"", self._socket.getsockname())
        self._reader.join(60)
        self._socket.close()


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Systemd]:
    """Listens, and is named in the environment; before `daemon`, so that hears of it."""
    address = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    monkeypatch.setenv("WATCHDOG_USEC", str(int(WATCHDOG_S * 1e6)))
    manager = Systemd(address)
    try:
        yield manager
    finally:
        manager.close()


def _pick_until_it_moves(station: Station) -> str:
    """Reset, pick, and wait until the arm is on its way; the cycle's id."""
    with client.connect(station) as cell, Bus.join(station.cell_id, station.bus.endpoint) as bus:
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)
        cycle_id = cell.command("pick").cycle_id
        arm = RemoteArm(bus, station.bus.ask_timeout_s)
        arm.connect()
        give_up_s = time.monotonic() + 60
        while np.abs(arm.state().dq_rad_s).max() < 0.3:
            assert time.monotonic() < give_up_s
            time.sleep(0.01)
        return cycle_id


def _children(process: subprocess.Popen[str]) -> list[Path]:
    """Where the kernel tells of the processes that this one has started, as long as they exist."""
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [Path(f"/proc/{pid}") for task in tasks for pid in task.read_text().split()]


# --- a real cell ------------------------------------------------------------------------------------------------------


def test_systemd_hears_how_it_is_until_sigterm_ends_it_and_its_node(systemd: Systemd, daemon: Cell) -> None:
    process, station = daemon
    systemd.wait_for("READY=1")
    systemd.wait_for("STATUS=Stopped")
    assert systemd.heard.count("READY=1") == 1
    systemd.wait_for("WATCHDOG=1")
    first_s = time.monotonic()
    for _ in range(2):
        systemd.wait_for("WATCHDOG=1")
    assert time.monotonic() - first_s > WATCHDOG_S / 2  # two halves, and not at every turn; the first is heard late
    with client.connect(station) as cell:
        cell.command("reset")
        systemd.wait_for("STATUS=Resetting, command 'reset' from cell-")
        systemd.wait_for("STATUS=Idle")
    assert "STOPPING=1" not in systemd.heard
    nodes = _children(process)
    process.send_signal(signal.SIGTERM)
    systemd.wait_for("STOPPING=1")
    assert process.wait(60) == 0
    assert nodes and not any(node.exists() for node in nodes), "no process is left"


def test_sigterm_in_the_middle_of_a_pick_is_a_controlled_stop(systemd: Systemd, daemon: Cell) -> None:
    process, station = daemon
    cycle_id = _pick_until_it_moves(station)
    process.send_signal(signal.SIGTERM)
    systemd.wait_for(f"STATUS=Execute, execute, cycle {cycle_id}")
    systemd.wait_for("STOPPING=1")
    assert process.wait(60) == 0
    (recording,) = station.recording.folder.rglob("*.mcap*")
    assert recording.name == f"{cycle_id}.mcap"
    with closing(sqlite3.connect(station.recording.folder / CATALOGUE)) as catalogue:
        assert catalogue.execute("SELECT cycle_id, result FROM cycles").fetchall() == [(cycle_id, "ABORTED")]
    record = read_cycle(recording)
    assert record.result is not None and (record.result.result, record.result.code) == ("ABORTED", "STOPPED")
    execution = record.stages["execute"].result
    assert isinstance(execution, Execution) and execution.stopped_in == "reach"
    motion = execution.runs[-1].motion
    assert not motion.finished and np.abs(motion.dq_rad_s).max() > 0.1 > np.abs(motion.dq_rad_s[-1]).max()


@pytest.mark.thorough
def test_a_second_sigterm_ends_at_once(systemd: Systemd, daemon: Cell) -> None:
    process, station = daemon
    _pick_until_it_moves(station)
    nodes = _children(process)
    process.send_signal(signal.SIGTERM)
    systemd.wait_for("STOPPING=1")
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == -signal.SIGTERM
    give_up_s = time.monotonic() + 60
    while any(node.exists() for node in nodes):  # each stops its arm and ends, when its daemon is gone
        assert time.monotonic() < give_up_s
        time.sleep(0.05)
    assert nodes


# --- without one ------------------------------------------------------------------------------------------------------


def test_a_machine_that_is_not_alive_strokes_no_watchdog(systemd: Systemd) -> None:
    service = Service(dict(os.environ))
    alive = True
    with service.around(lambda: alive):
        systemd.wait_for("READY=1")
        service.turn(None)
        systemd.wait_for("WATCHDOG=1")
        alive = False
        time.sleep(service.stroke_period_s)
        service.turn(None)
        service.turn(CellState(state="Idle", stage="", cycle_id="", since_ns=0, available=(), reason=""))
        systemd.wait_for("STATUS=Idle")
        assert systemd.heard[-2:] == ["WATCHDOG=1", "STATUS=Idle"]
        alive = True
        service.turn(None)
        systemd.wait_for("WATCHDOG=1")


def test_a_machine_takes_commands_unless_its_thread_hangs() -> None:
    released, asked = threading.Event(), threading.Event()

    def on_accept(_verb: str, _request: object) -> str:
        asked.set()
        released.wait(60)
        return ""

    machine = Machine({}, HoldState(), lambda _state, _reason: None, on_accept)
    machine.start()
    assert takes_commands(machine) and machine.state == "Stopped"
    answers: list[bool] = []
    hanging = threading.Thread(target=lambda: answers.append(takes_commands(machine)))
    machine.post("reset", CommandRequest())
    assert asked.wait(60)
    hanging.start()
    hanging.join(0.3)
    assert hanging.is_alive() and not answers
    released.set()
    hanging.join(60)
    assert answers == [True]
    machine.close()


def test_child_processes_are_not_told_of_the_socket(systemd: Systemd) -> None:
    environment = {**os.environ, "WATCHDOG_PID": str(os.getpid()), "HOME": "here"}
    assert Service(environment).stroke_period_s == WATCHDOG_S / 2
    assert not {"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"} & environment.keys() and "HOME" in environment


def test_a_watchdog_of_another_process_is_not_stroked(systemd: Systemd) -> None:
    assert Service({**os.environ, "WATCHDOG_PID": "1"}).stroke_period_s == 0.0


def test_a_socket_in_the_abstract_namespace() -> None:
    name = f"vlad-cell-test-{os.getpid()}"
    manager = Systemd(f"\0{name}")
    with Service({"NOTIFY_SOCKET": f"@{name}"}).around(lambda: True):
        manager.wait_for("READY=1")
    manager.wait_for("STOPPING=1")
    assert "WATCHDOG=1" not in manager.heard
    manager.close()


def test_nothing_happens_where_nobody_listens(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    state = CellState(state="Idle", stage="", cycle_id="", since_ns=0, available=(), reason="")
    with (unasked := Service({})).around(lambda: pytest.fail("no watchdog, no question")):
        unasked.turn(state)
    assert not caplog.records
    with (unheard := Service({"NOTIFY_SOCKET": str(tmp_path / "gone")})).around(lambda: True):
        unheard.turn(state)
    assert all("systemd does not hear us" in record.message for record in caplog.records) and len(caplog.records) == 3


# --- the unit file ----------------------------------------------------------------------------------------------------


def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    program = tmp_path / ".venv" / "bin" / "cell"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    unit = tmp_path / "vlad-cell@lab.service"
    unit.write_text(UNIT.read_text().replace("/opt/vlad-cell", str(tmp_path)))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True, timeout=60, check=False
    )
    ours = [line for line in done.stderr.splitlines() if "vlad-cell" in line]
    assert done.returncode == 0 and not ours, done.stderr
