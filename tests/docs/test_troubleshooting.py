"""docs/troubleshooting.md quotes what the code says; `…` stands for what varies."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "troubleshooting.md").read_text()
QUOTED = [line for block in re.findall(r"```text\n(.*?)```", TEXT, re.DOTALL) for line in block.splitlines()]
_SENTENCE_END = re.compile(r"(?<=[.?]) ")
_JOINED = re.compile(r'"\s*\n\s*f?"')
"""Where a text goes on in the next line of the code."""


@pytest.fixture(scope="module")
def code() -> str:
    """The product's source, with texts of several lines joined."""
    rooms = ("bus", "cell", "config", "drivers", "logs", "perception", "planning")
    return "\n".join(_JOINED.sub("", file.read_text()) for room in rooms for file in (ROOT / room).rglob("*.py"))


@pytest.mark.parametrize("line", QUOTED, ids=lambda line: line[:40])
def test_what_is_quoted_is_what_the_code_says(line: str, code: str) -> None:
    """Sentence by sentence: a reason and its advice are two texts of the code."""
    head = re.match(r"([A-Z_]{4,}):? ", line)
    assert head is None or f'"{head[1]}"' in code
    parts = line[head.end() if head else 0 :].replace("'…'", "…").split("…")
    sentences = [one.strip(" ().,'") for part in parts for one in _SENTENCE_END.split(part)]
    assert [one for one in sentences if one and one not in code] == []
