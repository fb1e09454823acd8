"""The report page: whole, self-contained, safe, for cycles that ended anywhere; and it renders."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from bus.errors import RecordingError
from logs.reader import read_cycle
from logs.report import write_report

Record = Callable[..., Path]
SECTIONS = ("stages", "seen", "imagined", "aligned", "grasps", "verdict", "motion", "about")


def _page(record: Record, tmp_path: Path, failed: str | None = None) -> str:
    return write_report(read_cycle(record(failed)), tmp_path / "page.html").read_text()


@pytest.mark.parametrize("failed", [None, "capture", "detect", "plan", "execute", "verify"])
def test_every_section_is_there_wherever_the_cycle_ended(record: Record, tmp_path: Path, failed: str | None) -> None:
    page = _page(record, tmp_path, failed)
    for section in SECTIONS:
        assert f'<section id="{section}">' in page
    assert ("FAILED NO_GRASP" in page) == (failed is not None)
    assert (f"{failed} failed." in page) == (failed is not None)


def test_nothing_is_loaded_from_elsewhere_and_nothing_recorded_runs(record: Record, tmp_path: Path) -> None:
    page = _page(record, tmp_path)
    body = page[: page.index("<script>")] + page[page.rindex("<script>") :]
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", body)
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page
    assert len(page) < 12e6


def test_a_page_that_cannot_be_written_says_so(record: Record, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="--output"):
        write_report(read_cycle(record()), tmp_path / "absent" / "page.html")


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_chromium_draws_every_figure_without_an_error(record: Record, tmp_path: Path) -> None:
    page = _page(record, tmp_path)
    probe = "<script>window.onerror = (m) => document.body.setAttribute('data-error', m);</script></head>"
    path = tmp_path / "probed.html"
    path.write_text(page.replace("</head>", probe, 1))
    done = subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--no-first-run",
         "--disable-background-networking", f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=8000",
         "--dump-dom", path.as_uri()],
        capture_output=True, text=True, timeout=90, check=True,
    )  # fmt: skip
    assert "data-error" not in done.stdout.partition("<body")[2][:200]
    drawn = re.findall(r'data-figure="([^"]+)"[^>]*><div class="plot-container', done.stdout)
    assert len(drawn) == 7 and "clouds" in drawn
    assert done.stdout.count('<path class="js-line') >= 7
