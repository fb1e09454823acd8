"""What is printed is shown, whatever it says; and an output that goes away ends nothing."""

from __future__ import annotations

import ast
import io
import json
import logging
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus import topics
from bus.codes import Code
from bus.commands import CellState
from bus.messages import CycleResult
from cell.cli.serving.console import Screen
from cell.terminal.drawing import console, table, tracked, words
from cell.terminal.printing import PlainFormatter, Printer, err, out, plain

ROOT = Path(__file__).parents[2]
MARKUP = "It refused: [/INST] [bold]no[/] [x] \\[y] :smile:"


def _ascii_stdout(monkeypatch: pytest.MonkeyPatch) -> io.BytesIO:
    """A stdout that knows 128 characters."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, "ascii", write_through=True))
    return written


def test_brackets_are_text(capsys: pytest.CaptureFixture[str]) -> None:
    out.line(("FAILED", "bold red"), f": {MARKUP}")
    rows = table(("why",))
    rows.add_row(words(MARKUP))
    rows.add_row(MARKUP)
    console(out, 200).print(rows)
    assert [line.strip() for line in capsys.readouterr().out.splitlines()] == [f"FAILED: {MARKUP}", "why"] + [
        MARKUP
    ] * 2


def test_a_refusal_with_brackets_is_shown_by_the_cells_own_screen(capsys: pytest.CaptureFixture[str]) -> None:
    result = CycleResult(cycle_id="c", object="[cup]", result="FAILED", code=Code.MODEL_REFUSED, reason=MARKUP,
                         stages={}, wall_s=1.0, recording="r/[1].mcap")  # fmt: skip
    screen = Screen(json_lines=False, report=False)
    screen.observe(topics.RESULT, result)
    next(screen.follow())
    said = capsys.readouterr().out
    assert f"FAILED MODEL_REFUSED [cup]: {MARKUP} (1.0 s)" in said and "recording r/[1].mcap" in said


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b[31mred\x1b[0m", "ared"),
        ("\x1b]0;title\x07b\x1b]52;c;Zm9v\x1b\\c", "bc"),
        ("\x9b2Jd\x1bce", "de"),
        ("one\r\ntwo\tthree\u2028four\x85five", "one two three four five"),
        ("\x00\x08\x7f\x1b", ""),
        ("\u202eevil\u2069", "evil"),
        ("caf\udce9.mcap \ud800", "caf\\xe9.mcap \\ud800"),
        ("Käse, 茶, 👩‍🔬", "Käse, 茶, 👩‍🔬"),
    ],
)  # fmt: skip
def test_nothing_commands_the_terminal(text: str, shown: str) -> None:
    assert plain(text) == shown
    assert words(text).plain == shown


@given(st.text(st.characters(), max_size=60))
def test_a_plain_text_is_one_printable_line(text: str) -> None:
    shown = plain(text)
    assert plain(shown) == shown and len(shown.splitlines()) <= 1 and "\x1b" not in shown
    shown.encode()


def test_what_the_terminal_lacks_is_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    written = _ascii_stdout(monkeypatch)
    out.line("Käse ", ("…", "bold"))
    rows = table(("name",))
    rows.add_row(words("a name that is far too long: ä"))
    console(out, 12).print(rows)
    list(tracked([1], 1, "Käse", out))
    assert written.getvalue().startswith(b"K\\xe4se \\u2026\nname")


@pytest.mark.parametrize(
    ("value", "meant"),
    [
        ({"a": "Käse \x7f\udce9"}, {"a": "Käse \x7f\udce9"}),
        ('{"a": "Käse \x7f 👩"}', {"a": "Käse \x7f 👩"}),
        (["👩", float("inf"), {"b": float("nan")}], ["👩", "Infinity", {"b": "NaN"}]),
    ],
)
def test_json_is_ascii_and_reads_back(monkeypatch: pytest.MonkeyPatch, value: object, meant: object) -> None:
    written = _ascii_stdout(monkeypatch)
    out.json(value)
    said = json.loads(written.getvalue().decode("ascii"), parse_constant=lambda name: pytest.fail(name))
    assert said == meant


def test_styles_are_for_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    with os.fdopen(slave, "w") as terminal:
        monkeypatch.setattr(sys, "stdout", terminal)
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.delenv("NO_COLOR", raising=False)
        out.line(("SUCCESS", "bold green"), ": held", style="dim")
        assert _line_of(master) == "\x1b[1;32mSUCCESS\x1b[0m\x1b[2m: held\x1b[0m\r\n"
        monkeypatch.setenv("NO_COLOR", "1")
        out.line(("SUCCESS", "bold green"))
        assert _line_of(master) == "SUCCESS\r\n"
    os.close(master)


def _line_of(master: int) -> str:
    """Read one line of a terminal; it may come in parts."""
    said = b""
    while not said.endswith(b"\n"):
        said += os.read(master, 200)
    return said.decode()


@pytest.mark.parametrize("stdout", [None, io.TextIOWrapper(io.BytesIO())], ids=["none", "closed"])
def test_no_output_is_no_error(monkeypatch: pytest.MonkeyPatch, stdout: io.TextIOWrapper | None) -> None:
    if stdout is not None:
        stdout.close()
    monkeypatch.setattr(sys, "stdout", stdout)
    printer = Printer()
    for _ in range(2):
        printer.line("text", style="bold")
        printer.json({})
        console(printer).print(words("text"))


@pytest.mark.parametrize("to", ["pipe", "/dev/full"])
def test_an_output_that_goes_away_ends_nothing_and_is_remembered(to: str) -> None:
    source = """
import sys
from cell.terminal.printing import out
for number in range(10000): out.line(f"{number} of many lines")
print(type(out.lost).__name__, file=sys.stderr)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", source], cwd=ROOT, stderr=subprocess.PIPE, text=True,
        stdout=subprocess.PIPE if to == "pipe" else os.open(to, os.O_WRONLY),
    )  # fmt: skip
    if process.stdout is not None:
        process.stdout.close()
    assert process.communicate(timeout=60)[1].strip() in ("BrokenPipeError", "OSError") and process.returncode == 0


def test_a_log_line_is_plain_and_its_traceback_stays() -> None:
    try:
        raise ValueError("why")
    except ValueError:
        record = logging.LogRecord("n", logging.ERROR, "", 1, "\x1b[31mbad\nworse", (), sys.exc_info())
    first, *rest = PlainFormatter("%(message)s").format(record).splitlines()
    assert first == "bad worse" and rest[0].startswith("Traceback") and rest[-1] == "ValueError: why"


def test_a_state_says_who_brought_it_about(capsys: pytest.CaptureFixture[str]) -> None:
    screen = Screen(json_lines=False, report=False)
    reasons = ("command 'stop' from watch-ann-lab2-4711", "", "The lease of 'x' was lost.")
    for state, reason in zip(("Stopping", "Stopped", "Holding"), reasons, strict=True):
        message = CellState(state=state, stage="", cycle_id="", since_ns=0, available=(), reason=reason)
        screen.observe(topics.STATE, message)
    heard = screen.follow()
    for _ in reasons:
        next(heard)
    shown = ["Stopping by watch-ann-lab2-4711", "Stopped", "Holding", "The lease of 'x' was lost."]
    assert [line.strip() for line in capsys.readouterr().out.splitlines()] == shown


# --- so that it stays so ----------------------------------------------------------------------------------------------

_ONLY = {"cell/terminal/printing.py", "cell/terminal/drawing.py"}
_NOT_ELSEWHERE = {
    "typer.echo", "typer.secho", "typer.style", "rich.print", "rich.print_json", "rich.console.Console",
    "rich.markup", "rich.text.Text", "rich.progress", "rich.prompt", "click.echo",
}  # fmt: skip


def _names_used(tree: ast.Module) -> Iterator[str]:
    """Yield what a module imports, and what it takes of the modules it imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            yield f"{node.value.id}.{node.attr}"


@pytest.mark.parametrize("room", ["bus", "config", "drivers", "perception", "planning", "logs", "cell", "vlad_cell"])
def test_only_the_modules_of_printing_print(room: str) -> None:
    for path in sorted((ROOT / room).rglob("*.py")):
        name = str(path.relative_to(ROOT))
        if name not in _ONLY:
            used = set(_names_used(ast.parse(path.read_text()))) & _NOT_ELSEWHERE
            allowed = (
                {"rich.console.Console", "rich.text.Text"}
                if name in ("cell/cli/picks/watch.py", "cell/cli/picks/watch_screen.py")
                else set()
            )
            assert not used - allowed, f"{name} uses {used}: print with cell.terminal.printing or cell.terminal.drawing"


def test_the_printers_are_those_of_stdout_and_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    out.line("to the one")
    err.line("to the other")
    assert capsys.readouterr() == ("to the one\n", "to the other\n")
