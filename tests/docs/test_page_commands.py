"""Every command that a page, a station file or an advice names is one that there is; nothing is carried out.

Parsed are its options, its arguments and their forms, by the commands themselves; `--set` by the station's schema.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from tests.docs.command_lines import ROOT, Line, lines_of, named_in, problems

PAGES = sorted(
    path
    for below in ("*.md", "docs/*.md", "docs/*/*.md", "examples/*/*.md")
    for path in ROOT.glob(below)
    if path.name != "CHANGELOG.md"  # it tells of what was
)
STATIONS = sorted([*ROOT.glob("config/*.toml"), *ROOT.glob("examples/*/*.toml")])
ROOMS = ("bus", "cell", "config", "docs", "drivers", "logs", "perception", "planning", "stand_ins", "vlad_cell")


def _wrong(lines: Iterable[Line]) -> tuple[dict[Line, list[str]], int]:
    """Line -> what is wrong with it, and how many lines there are."""
    known = {line: problems(line) for line in lines}
    return {line: found for line, found in known.items() if found}, len(known)


def test_every_command_on_every_page_is_understood() -> None:
    wrong, count = _wrong(line for page in PAGES for line in lines_of(page.read_text()))
    assert not wrong
    assert count > 2000, "all of them were looked at"


def test_so_is_what_a_station_file_begins_with() -> None:
    lines = [line.lstrip("# ") for file in STATIONS for line in file.read_text().splitlines() if line.startswith("# ")]
    wrong, _ = _wrong(Line(line) for line in lines if line.startswith("uv run"))
    assert not wrong


def test_so_is_what_the_cell_advises() -> None:
    files = [*(file for room in ROOMS for file in (ROOT / room).rglob("*.py")), *ROOT.glob("cell/http/page/*.js")]
    wrong, count = _wrong(line for file in files for line in named_in(file.read_text()))
    assert not wrong
    assert count > 50


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("uv run cell cycles --faild", "No such option: --faild"),
        ("cell shoo CYCLE", "no command shoo"),
        ("cell config renew mine.toml", "config has no command renew"),
        ("cell status CYCLE", "status takes no CYCLE"),
        ("env/bin/cell show", "cycle is missing"),
        ("cell start --cycles many", "valid integer"),
        ("cell start --cycles 0", "greater than or equal to 1"),
        ("cell fault camera melt", "'melt'"),
        ("sudo -u vlad-cell /opt/vlad-cell/env/bin/cell start --set sim.pce=1", "no setting sim.pce"),
        ("cell reset && cell pik", "no command pik"),
        ("cell config show|chek mine.toml", "config has no command chek"),
        ("just tuor", "no recipe tuor"),
        ("uv run python -m benchmarks pickz", "no benchmark pickz"),
        ("uv run python -m benchmarks cycle --seedz 3", "cycle has no option --seedz"),
        ("python -m docs.page_pictures", "no module docs.page_pictures"),
        ("MUJOCO_GL=egl python3 -m stand_ins.cel", "no module stand_ins.cel"),
    ],
)
def test_what_is_not_there_is_noticed(line: str, said: str) -> None:
    (found,) = problems(Line(line))
    assert said in found


@pytest.mark.parametrize(
    "line",
    [
        "uv run cell show CYCLE   # a part of its id will do",
        'cell query "SELECT code, count(*) FROM cycles WHERE cost_usd > 1 GROUP BY code"',
        "cell cycles [--failed] [--day today]",
        "cell start --cycles N --objects FOLDER",
        "cell config check mine.toml",
        "cell node NAME --config ...",
        "OMP_NUM_THREADS=1 just test -k catalogue",
        "cell config schema > station.schema.json",
    ],
)
def test_what_is_there_is_understood(line: str) -> None:
    assert problems(Line(line)) == []


@pytest.mark.parametrize(("line", "said"), [("cell show", []), ("cell query --parquet", []), ("cell pick --placed", 1)])
def test_in_running_text_a_name_is_enough(line: str, said: list[str] | int) -> None:
    assert len(problems(Line(line, is_named=True))) == (said if isinstance(said, int) else 0)
