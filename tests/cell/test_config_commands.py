"""``cell config show``, ``check``, ``diff``, ``schema``, ``new``."""

from __future__ import annotations

import json
import subprocess
import tomllib
from collections.abc import Callable
from pathlib import Path

from config.load import DEFAULT_STATION, load_station
from config.schema import Station

Run = Callable[..., subprocess.CompletedProcess[str]]
LAB = str(DEFAULT_STATION.with_name("lab.toml"))


def test_show_prints_a_station_file_of_what_counts(in_process: Run) -> None:
    done = in_process("config", "show", "--config", LAB, "--set", "arm.speed=0.5")
    assert Station.model_validate(tomllib.loads(done.stdout)) == load_station(Path(LAB), ["arm.speed=0.5"])
    (speed,) = [line for line in done.stdout.splitlines() if line.startswith("speed = ")]
    assert speed.endswith("# --set")


def test_show_of_one_setting_says_where_it_comes_from(in_process: Run) -> None:
    done = in_process("config", "show", "bus.stale_s", "--json")
    assert json.loads(done.stdout) == {"bus.stale_s": {"value": 5.0, "origin": "sim.toml:6"}}


def test_show_of_no_setting_is_refused(in_process: Run) -> None:
    done = in_process("config", "show", "verfy")
    assert done.returncode == 2 and "'verfy'. Did you mean 'verify'?" in done.stderr


def test_check_prints_a_line_a_mistake_and_exits_2(in_process: Run, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text("[bus]\nstale = 3\n[sim]\npace = 'fast'\n")
    done = in_process("config", "check", LAB, str(file))
    assert done.returncode == 2
    fine, _, nodes, bus, sim, again = done.stdout.splitlines()
    assert "check again" in again
    assert fine == f"{LAB}: no mistakes" and nodes.startswith(f"{file}: nodes: is missing.")
    assert "cell config new" in nodes, "lines of a page are only a part of a station file"
    assert bus == f"{file}:2: [bus] stale: unknown key. Did you mean 'stale_s'?" and sim.startswith(f"{file}:4: [sim]")


def test_check_names_the_lines_that_are_still_to_decide_and_they_are_no_mistake(
    in_process: Run, tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        DEFAULT_STATION.read_text()
        + '[sim]\nseed = 1   # CHANGE\n# CHANGE here, too\nobjects = "a # CHANGE"   # lines marked CHANGE are counted\n'
    )
    lines = file.read_text().splitlines()
    marked = [len(lines) - 2, len(lines) - 1]
    done = in_process("config", "check", str(file))
    assert done.returncode == 0 and done.stdout.splitlines()[0] == f"{file}: no mistakes"
    assert f"2 lines still hold values of another cell, or to decide on: {', '.join(map(str, marked))}." in done.stdout
    done = in_process("config", "check", "--json", str(file), str(DEFAULT_STATION))
    assert json.loads(done.stdout) == {"file": str(file), "undecided": marked}


def test_diff_compares_what_counts_and_not_how_it_is_written(in_process: Run, tmp_path: Path) -> None:
    same, other = tmp_path / "same.toml", tmp_path / "other.toml"
    same.write_text(DEFAULT_STATION.read_text() + "[sim]\nseed = 0\n")
    other.write_text(DEFAULT_STATION.read_text() + "[sim]\nseed = 7\n")
    assert in_process("config", "diff", str(DEFAULT_STATION), str(same)).stdout == "nothing differs\n"
    done = in_process("config", "diff", str(DEFAULT_STATION), str(other))
    assert done.returncode == 1 and done.stdout.split() == ["sim.seed", "0", "->", "7"]


def test_a_new_file_is_right_and_never_replaces_another(in_process: Run, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    assert in_process("config", "new", str(file)).returncode == 0
    assert in_process("config", "check", str(file)).returncode == 0
    done = in_process("config", "new", str(file))
    assert done.returncode == 2 and "is there already" in done.stderr


def test_the_schema_is_json(in_process: Run) -> None:
    assert json.loads(in_process("config", "schema").stdout)["title"] == "VLAD Cell station"
