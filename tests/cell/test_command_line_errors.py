"""Bad input: one clear line with advice, the right exit code, no traceback."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cell.cli import commands
from cell.cli.serving.start import _opening, _ready
from config.load import DEFAULT_STATION, load_station

Run = Callable[..., subprocess.CompletedProcess[str]]


def _process(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """As a user runs it."""
    return subprocess.run(
        [sys.executable, "-m", "cell", *arguments],
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
        env={**os.environ, **environment},
    )


def _says(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    (line,) = done.stderr.strip().splitlines()
    for word in words:
        assert word in line


def test_an_unknown_key_is_named_with_its_neighbour(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--set", "sim.pase=1", *options), 2, "--set sim.pase", "'sim.pace'")


def test_a_missing_station_file(in_process: Run) -> None:
    _says(in_process("start", "--config", "absent.toml"), 2, "absent.toml", "Is its path right?")


def test_an_unknown_driver_lists_the_installed_ones(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--set", "nodes.sim.driver=warp", *options), 2, "warp", "sim")


def test_a_folder_without_objects(in_process: Run, options: list[str], tmp_path: Path) -> None:
    _says(in_process("start", "--objects", str(tmp_path), *options), 2, str(tmp_path), "object.xml")


def test_a_folder_named_like_a_number_is_a_folder(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--objects", "2026", *options), 2, "No object in 2026", "object.xml")


def test_a_folder_whose_name_is_no_utf8(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--objects", os.fsdecode(b"caf\xe9"), *options), 2, "sim.objects", "not UTF-8")


def test_a_port_that_is_none_is_no_occupied_one(in_process: Run) -> None:
    _says(in_process("start", "--set", "bus.endpoint=tcp/127.0.0.1:99999"), 2, "bus.endpoint", "99999")


def test_a_station_file_that_cannot_be_written_is_said_before_the_arm_moves(in_process: Run, tmp_path: Path) -> None:
    path = tmp_path / "station.toml"
    path.write_text('[nodes.sim]\ndriver = "none of them"\nserves = ["camera", "arm", "hand"]\n')
    path.chmod(0o444)
    _says(in_process("calibrate", "hand-eye", "--config", str(path)), 2, str(path), "read-only", "--dry-run")


def test_no_egl(in_process: Run, options: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "99")
    _says(in_process("start", "--cycles", "1", *options), 2, "apt-get install", "libegl1")


def test_an_occupied_port(in_process: Run, options: list[str], endpoint: str) -> None:
    host, port = endpoint.removeprefix("tcp/").split(":")
    with socket.create_server((host, int(port))):
        done = in_process("start", "--cycles", "1", *options)
        _says(done, 4, endpoint, "cell status")


def test_a_current_folder_that_was_deleted(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    words = ["sh", "-c", 'rmdir "$PWD" && exec "$0" cycles', str(Path(sys.executable).with_name("cell"))]
    done = subprocess.run(words, cwd=tmp_path / "gone", capture_output=True, text=True)
    _says(done, 2, "does not exist any more", "cd DIR")


def test_no_cell_to_talk_to(in_process: Run, options: list[str]) -> None:
    _says(in_process("status", *options), 4, "cell start")


@pytest.mark.parametrize("command", ["replay", "report", "show"])
@pytest.mark.parametrize("content", [None, b"", b"not an MCAP", b"\x89MCAP0\r\n" + bytes(100)])
def test_a_recording_that_is_none(in_process: Run, tmp_path: Path, command: str, content: bytes | None) -> None:
    path = tmp_path / "cycle.mcap"
    if content is not None:
        path.write_bytes(content)
    _says(in_process(command, str(path)), 2, str(path))


def test_a_wrong_command_is_a_usage_error_with_its_neighbour(in_process: Run) -> None:
    _says(in_process("statsu"), 2, "statsu", "'status'", "cell --help")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["start", "--cycles", "2000000"], ["--cycles", "1000000"]),
        (["run", "--cycles", "0"], ["--cycles", "1"]),
        (["run"], ["--cycles", "--until-empty"]),
        (["run", "--cycles", "1", "--until-empty"], ["--cycles", "--until-empty"]),
        (["pick", "--object", "x" * 101], ["--object", "100"]),
        (["pick", "--object", "caf\udce9"], ["--object", "UTF-8"]),
        (["fault", "bus", "wobbly"], ["Invalid value for 'word': 'wobbly' is not one of 'none', 'off'"]),
        (["fault", "bus", "slow", "--delay-s", "nan"], ["--delay-s"]),
        (["fault", "bus", "slow", "--delay-s=-1"], ["--delay-s", "0"]),
        (["replay", "x", "--publish", "--wait-s", "inf"], ["--wait-s", "finite"]),
        (["start", "--nonsense"], ["--nonsense"]),
        (["show", "a", "b"], ["extra"]),
        (["report"], ["FILE"]),
    ],
    ids=lambda value: " ".join(value)[:30],
)
def test_an_option_out_of_its_range_is_named(in_process: Run, arguments: list[str], words: list[str]) -> None:
    _says(in_process(*arguments), 2, *words)


def test_a_usage_error_is_json_too(in_process: Run) -> None:
    done = in_process("run", "--json")
    assert json.loads(done.stdout)["code"] == "USAGE" and done.returncode == 2


def test_without_a_command_it_shows_its_help(in_process: Run) -> None:
    done = in_process()
    assert done.returncode == 2 and "Commands:" in done.stdout and done.stderr == ""


@pytest.mark.parametrize("command", ["cycles", "show", "report", "replay", "recover"])
@pytest.mark.parametrize("name", ["x" * 300 + ".mcap", "file/x.mcap", "/root/\udce9.mcap"])
def test_a_name_that_no_file_can_have(in_process: Run, tmp_path: Path, command: str, name: str) -> None:
    (tmp_path / "file").write_text("")
    done = in_process(command, str(tmp_path / name))
    assert done.returncode == 2 and "Traceback" not in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "output", ["board", "board.pngg", "board.jpg", "absent/board.png", "\udce9/b.png", "x" * 300 + ".png"]
)
def test_a_board_that_cannot_be_written(in_process: Run, tmp_path: Path, output: str) -> None:
    _says(in_process("calibrate", "board", "-o", str(tmp_path / output)), 2)


def test_a_board_may_have_any_name(in_process: Run, tmp_path: Path) -> None:
    path = tmp_path / "[b]caf\udce9.PNG"
    done = in_process("calibrate", "board", "-o", str(path))
    assert done.returncode == 0 and "[b]caf\\xe9.PNG" in done.stdout and path.read_bytes().startswith(b"\x89PNG")


def test_the_version_is_said(in_process: Run) -> None:
    assert re.fullmatch(
        r"cell \d+\.\d+\.\d+(\.dev\d+)?( \(commit [0-9a-f]{12}\+?\))?\n", in_process("--version").stdout
    )


def test_a_defect_is_called_one_and_is_no_success(
    in_process: Run, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise TypeError("not [foreseen]")

    monkeypatch.setattr(commands, "command", broken)
    done = in_process("status")
    assert done.returncode == 5 and "TypeError: not [foreseen]" in done.stderr and "This is a defect" in done.stderr
    assert caplog.records[-1].exc_info is not None  # the traceback, in the log


def test_a_file_that_nobody_may_read_is_no_defect(in_process: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", "/var/lib/[lab]/x.mcap")

    monkeypatch.setattr(commands, "command", forbidden)
    _says(in_process("status"), 2, "/var/lib/[lab]/x.mcap: Permission denied")


# --- what is imported for it ------------------------------------------------------------------------------------------

_HEAVY = {"numpy", "cv2", "scipy", "mujoco", "pinocchio", "google.protobuf", "mcap", "rich", "logs", "perception",
          "planning", "drivers", "cell.daemon.daemon", "cell.pick.cycle"}  # fmt: skip


def _imported(source: str) -> set[str]:
    done = subprocess.run([sys.executable, "-c", f"import sys; {source}; print(*sys.modules)"],
                          capture_output=True, text=True, check=True)  # fmt: skip
    return set(done.stdout.splitlines()[-1].split())  # above it is what the command itself prints


def test_an_operator_in_a_hurry_waits_for_no_import() -> None:
    commands_ = [f"command({name!r})" for name in ("status", "stop", "reset", "pick", "run")]
    source = ["from cell.cli.commands import command", "import cell.command, config.load", *commands_]
    assert not _imported("; ".join([*source, "config.load.load_station()"])) & _HEAVY


def test_help_imports_no_command() -> None:
    source = "import cell.command; sys.argv[1:] = ['--help']\ntry: cell.command.main()\nexcept SystemExit: pass"
    names = _imported(source.replace("; sys", "\nsys"))
    assert not names & (_HEAVY | {f"cell.cli.{row.module}" for row in commands.COMMANDS.values()})


def test_the_short_helps_are_the_commands_own() -> None:
    for name, row in commands.COMMANDS.items():
        paragraph = (commands.command(name).help or "").split("\n\n")[0]
        assert " ".join(paragraph.split()) == row.help, name


@pytest.mark.parametrize("shell", ["bash", *(pytest.param(one, marks=pytest.mark.thorough) for one in ("zsh", "fish"))])
def test_the_shell_completes_commands_and_their_options(shell: str) -> None:
    environment = {"_CELL_COMPLETE": f"complete_{shell}", "COMP_CWORD": "1", "_TYPER_COMPLETE_ARGS": "cell sta"}
    for words, expected in (("cell sta", {"start", "status"}), ("cell status --j", {"--json"})):
        count = str(len(words.split()) - 1)
        said = _process(**environment | {"COMP_WORDS": words, "COMP_CWORD": count, "_TYPER_COMPLETE_ARGS": words,
                                         "_TYPER_COMPLETE_FISH_ACTION": "get-args"})  # fmt: skip
        assert all(name in said.stdout for name in expected), said


@pytest.mark.parametrize(
    ("run", "said"),
    [
        ("here", "starting camera, rest ..."),
        ("elsewhere", "starting camera ...; elsewhere, by `cell node`: rest"),
    ],
)
def test_a_cell_says_which_nodes_it_starts_and_which_others_serve(run: str, said: str) -> None:
    camera = '{driver = "sim", serves = ["camera"]}'
    rest = f'{{driver = "sim", serves = ["arm", "hand"], run = "{run}"}}'
    assert _opening(load_station(None, [f"nodes={{camera = {camera}, rest = {rest}}}"])) == said


@pytest.mark.parametrize(
    ("config", "overrides", "each"),
    [
        (DEFAULT_STATION, ["sim.pace=1"], ""),
        (Path("my st.toml"), ["bus.endpoint=tcp/127.0.0.1:7600", "sim.pace=1", "cell_id=b"],
         ", each with --config 'my st.toml' --set bus.endpoint=tcp/127.0.0.1:7600 --set cell_id=b"),
    ],
)  # fmt: skip
def test_the_ready_line_leads_to_this_very_cell(
    config: Path, overrides: list[str], each: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("UV_RUN_RECURSION_DEPTH", raising=False)
    assert _ready(config, overrides) == (
        f"ready. From another terminal{each}: cell reset, cell pick, cell status. Ctrl-C ends."
    )


def test_a_start_names_what_may_take_long_to_load() -> None:
    assert _opening(load_station()) == "starting sim ..."
    theirs = load_station(None, ["perception.detector=acme", "perception.model=imagining"])
    assert _opening(theirs) == "starting sim, the detector acme, the goal-image model imagining ..."
