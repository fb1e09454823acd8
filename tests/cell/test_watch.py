"""``cell watch`` as an operator has it: in a terminal of its own, against a running cell."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from fcntl import ioctl
from pathlib import Path
from typing import Any

import pytest

from bus.errors import Refused
from cell import client
from cell.build import running_cell
from config.load import load_station
from config.schema import Station

_ESCAPE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|.)")


class Terminal:
    """A pseudo-terminal with ``cell watch`` in it."""

    def __init__(self, options: list[str]) -> None:
        self._master, self._slave = pty.openpty()
        ioctl(self._slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 120, 0, 0))
        self.before = self.settings()
        self._raw = b""
        environment = {**os.environ, "TERM": "xterm-256color"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "cell", "watch", *options],
            stdin=self._slave, stdout=self._slave, stderr=self._slave, start_new_session=True, env=environment,
        )  # fmt: skip

    def settings(self) -> list[Any]:
        return termios.tcgetattr(self._slave)

    def press(self, key: str) -> None:
        self._raw = b""
        os.write(self._master, key.encode())

    def wait_for(self, pattern: str, timeout_s: float = 60.0) -> str:
        """The text since the last key once it matches."""
        give_up_s = time.monotonic() + timeout_s
        while not re.search(pattern, text := self._text()):
            assert time.monotonic() < give_up_s and self.process.poll() is None, f"no {pattern!r} in:\n{text}"
            self._read(0.1)
        return text

    def end(self) -> tuple[int, str]:
        """The exit code, and what was written last."""
        give_up_s = time.monotonic() + 60
        while self.process.poll() is None:
            assert time.monotonic() < give_up_s
            self._read(0.1)
        self._read(0.1)
        return self.process.wait(), self._raw.decode(errors="replace")

    def hang_up(self) -> int:
        """Take the terminal away; the exit code."""
        os.close(self._slave)
        os.close(self._master)
        self._slave = self._master = -1
        return self.process.wait(60)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        if self._master >= 0:
            os.close(self._master)
            os.close(self._slave)

    def _read(self, timeout_s: float) -> None:
        while select.select([self._master], [], [], timeout_s)[0]:
            self._raw += os.read(self._master, 65536)
            timeout_s = 0.0

    def _text(self) -> str:
        return _ESCAPE.sub("", self._raw.decode(errors="replace"))


@pytest.fixture
def terminal(shared_cell: Station, shared_options: list[str]) -> Iterator[Terminal]:
    with closing(Terminal(shared_options)) as one:
        yield one


def test_keys_command_the_cell_and_refusals_say_why(terminal: Terminal, shared_cell: Station) -> None:
    terminal.wait_for(r"cell sim +Stopped")
    terminal.wait_for(r"sim +\d s ago")
    assert not terminal.settings()[3] & termios.ECHO
    terminal.press("u")
    terminal.wait_for(r"unhold: WRONG_STATE: 'unhold' is not possible while the cell is Stopped")
    terminal.press("r")
    terminal.wait_for(r"reset: accepted")
    terminal.wait_for(r"cell sim +Idle")
    terminal.press("p")
    terminal.wait_for(r"pick: accepted, cycle \d{8}T\d{9}")
    terminal.wait_for(r"cell sim +Execute +execute")
    terminal.press("h")
    terminal.wait_for(r"cell sim +Held")
    terminal.press("u")
    terminal.wait_for(r"unhold: accepted")
    terminal.press("s")
    terminal.wait_for(r"cell sim +Stopped")
    terminal.wait_for(r"\d{8}T\d{9} +ABORTED +STOPPED")
    terminal.wait_for(r"Stopped by watch-")
    _reset_once_the_lease_is_free(shared_cell)
    terminal.wait_for(r"cell sim +Idle")
    terminal.press("q")
    code, _ = terminal.end()
    assert code == 0 and terminal.settings() == terminal.before


def _reset_once_the_lease_is_free(station: Station) -> None:
    """The view gives the lease back by itself, in its next turn."""
    give_up_s = time.monotonic() + 60.0
    with client.connect(station) as cell:
        while True:
            try:
                cell.command("reset")
                break
            except Refused as refused:
                assert refused.code == "LEASE_HELD" and time.monotonic() < give_up_s
                time.sleep(0.05)
        cell.wait_for_state({"Idle"}, 60)


@pytest.mark.thorough
def test_an_arrow_key_is_no_command(terminal: Terminal, shared_cell: Station) -> None:
    terminal.wait_for(r"cell sim +Stopped")
    terminal.press("\x1b[a\x1bOa\x1b[200~")  # with "a" in it, which would abort
    terminal.press("x")
    terminal.press("u")
    terminal.wait_for("WRONG_STATE")
    with client.connect(shared_cell) as cell:
        assert cell.state().state == "Stopped"


@pytest.mark.parametrize(
    "number",
    [signal.SIGTERM, *(pytest.param(one, marks=pytest.mark.thorough) for one in (signal.SIGINT, signal.SIGHUP))],
)
def test_a_signal_ends_the_view_and_restores_the_terminal(terminal: Terminal, number: signal.Signals) -> None:
    terminal.wait_for(r"cell sim +Stopped")
    assert terminal.settings() != terminal.before
    terminal.process.send_signal(number)
    code, written = terminal.end()
    assert code == 0 and terminal.settings() == terminal.before
    assert "\x1b[?25h" in written, written  # the cursor
    assert "\x1b[?1049l" in written  # the screen that was there before


def test_it_ends_when_its_terminal_does(terminal: Terminal) -> None:
    terminal.wait_for(r"cell sim +Stopped")
    assert terminal.hang_up() == 0


@pytest.mark.thorough
def test_a_cell_that_goes_away_is_shown_and_waited_for(options: list[str]) -> None:
    station = load_station(None, options[1::2])
    with ExitStack() as stack:
        with running_cell(station, lambda topic, message: None):
            terminal = stack.enter_context(closing(Terminal(options)))
            terminal.wait_for(r"cell sim +Stopped")
        terminal.wait_for(r"has ended, or the link to it")
        with running_cell(station, lambda topic, message: None):
            terminal.press("x")  # forget what was shown
            terminal.wait_for(r"(?s)cell sim +Stopped((?!has ended|cell sim).)*cycles")
            terminal.wait_for(r"sim +\d s ago +\d s +0 +0")
            terminal.press("r")
            terminal.wait_for(r"cell sim +Idle")


def _once(options: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cell", "watch", "--once", *options],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.mark.thorough
def test_once_prints_the_view_with_what_was_recorded_before(shared_cell: Station, shared_options: list[str]) -> None:
    with client.connect(shared_cell) as cell:
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)
        result = cell.wait_for_result(cell.command("pick", object_name="bottle").cycle_id, 60)
        cell.wait_for_state({"Complete"}, 60)
    torn = Path(result.recording).with_name("99991231T235959999.mcap")
    torn.write_bytes(Path(result.recording).read_bytes()[:1000])
    done = _once(shared_options)
    assert done.returncode == 0, done.stderr
    assert re.match(r"cell sim +Complete", done.stdout) and "available: reset, pick, stop, abort" in done.stdout
    assert re.search(rf"{result.cycle_id} +{result.result} .*bottle +{result.wall_s:.1f} s", done.stdout)
    assert re.search(r"sim +[01] s ago", done.stdout)


def test_no_cell_no_view(options: list[str]) -> None:
    done = _once(options)
    assert done.returncode == 4 and "UNREACHABLE_CELL" in done.stderr
