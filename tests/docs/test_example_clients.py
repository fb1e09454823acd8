"""The clients of docs/examples end with one clear line, and no traceback, where they cannot go on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "examples"
NOBODY = "127.0.0.1:1"


@pytest.mark.parametrize(
    "arguments",
    [("trigger.py", "sim", "{}", f"tcp/{NOBODY}"), ("http_client.py", f"http://{NOBODY}")],
    ids=lambda a: a[0],
)
def test_where_nobody_listens_it_says_so(arguments: tuple[str, ...]) -> None:
    ended = subprocess.run([sys.executable, *arguments], cwd=FOLDER, capture_output=True, text=True, timeout=60)
    (line,) = ended.stderr.splitlines()
    assert ended.returncode == 1 and line.startswith("Nobody") and NOBODY in line
