"""A simulated cell ends with its ``with``, however that ends, and with its program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from bus.errors import DriverUnavailable, PortOccupied
from bus.remote_errors import error_reply
from cell.nodes.ready import Open
from config.load import load_station
from config.schema import Station
from vlad_cell import Cell, CellUnreachable, ConfigError, simulated_cell, simulation

OPENS = 'print(\'{"endpoint": "tcp/here", "pid": 1}\', flush=True);'
STAYS = "import sys; sys.stdin.read()"
Children = list[subprocess.Popen[str]]


def refuses(error: Exception) -> str:
    """A child that says why it cannot start."""
    assert isinstance(error, DriverUnavailable | PortOccupied)
    return f"print({Open(pid=1, error=error_reply(error)).model_dump_json()!r}, flush=True)"


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Children]:
    """Makes Python programs stand in for the cells that are started, one after the other."""

    def stand_in(*programs: str) -> Children:
        begun: Children = []

        def spawn(_station: Station, *_module: str) -> subprocess.Popen[str]:
            command = [sys.executable, "-I", "-S", "-c", programs[len(begun)]]
            begun.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
            return begun[-1]

        monkeypatch.setattr(simulation, "spawn_child", spawn)
        return begun

    return stand_in


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_it_ends_whatever_ends_the_with(children: Callable[..., Children], error: type[BaseException]) -> None:
    begun = children(OPENS + STAYS)
    with pytest.raises(error), simulation.running(load_station()) as there:
        assert there.bus.endpoint.startswith("tcp/127.0.0.1:") and there.bus.endpoint != load_station().bus.endpoint
        raise error
    assert [child.returncode for child in begun] == [0]


def test_what_keeps_it_from_starting_is_raised(children: Callable[..., Children]) -> None:
    begun = children(refuses(DriverUnavailable("There is no display.", "Set MUJOCO_GL=egl.")))
    with pytest.raises(DriverUnavailable, match="MUJOCO_GL"), simulation.running(load_station()):
        pass
    assert all(child.poll() is not None for child in begun)


def test_a_port_that_is_taken_meanwhile_is_given_up_for_another(children: Callable[..., Children]) -> None:
    begun = children(refuses(PortOccupied("Taken.")), OPENS + STAYS)
    with simulation.running(load_station()):
        assert len(begun) == 2 and begun[0].poll() is not None
    assert begun[1].returncode == 0


def test_real_devices_are_not_started_by_a_program() -> None:
    lab = Path(simulation.__file__).parents[1] / "config" / "lab.toml"
    with pytest.raises(ConfigError, match="real devices"):
        simulated_cell(config=lab)


def test_what_a_program_leaves_open_is_closed_when_its_main_thread_ends() -> None:
    program = """if True:
        import threading
        from bus.at_end import cancel_close_at_end, close_at_end
        goes_on = threading.Event()
        threading.Thread(target=goes_on.wait).start()  # as those of the bus, the interpreter waits for it
        for name in ("first", "second"):
            close_at_end(lambda name=name: print(name, "closed", flush=True))
        gone = lambda: print("never")
        close_at_end(goes_on.set)
        close_at_end(lambda: 1 / 0)  # a defect, called before the others
        close_at_end(gone)
        cancel_close_at_end(gone)
        print("done", flush=True)
    """
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines() == ["done", "second closed", "first closed"] and done.returncode == 0, done.stderr
    assert "defect in end" in done.stderr and "ZeroDivisionError" in done.stderr


@pytest.mark.thorough
def test_a_program_that_closes_nothing_ends_and_its_cell_with_it(tmp_path: Path) -> None:
    program = "from vlad_cell import simulated_cell; cell = simulated_cell(); cell.reset(); print(cell.endpoint)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with pytest.raises(CellUnreachable):
        Cell(done.stdout.strip())


@pytest.mark.thorough
def test_it_ends_with_a_program_that_is_killed(tmp_path: Path) -> None:
    program = "from vlad_cell import simulated_cell; cell = simulated_cell(); print(cell.endpoint, flush=True); input()"
    running = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path
    )
    assert running.stdout is not None
    endpoint = running.stdout.readline().strip()
    Cell(endpoint).close()
    os.kill(running.pid, signal.SIGKILL)
    running.communicate()
    give_up_s = time.monotonic() + 60
    with pytest.raises(CellUnreachable):
        while time.monotonic() < give_up_s:
            Cell(endpoint).close()
            time.sleep(0.2)
