"""docs/api.md: written from the docstrings, and these say what every argument is."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import pytest

import vlad_cell
from docs import api_page
from vlad_cell import job, pick, said, station


def _functions() -> Iterator[Any]:
    """The public functions, and the public methods of the public classes."""
    for name in vlad_cell.__all__:
        what = getattr(vlad_cell, name)
        if inspect.isfunction(what):
            yield pytest.param(what, id=name)
        elif inspect.isclass(what) and what.__module__.startswith("vlad_cell."):
            for member, value in inspect.getmembers(what, lambda one: inspect.isfunction(one) or inspect.ismethod(one)):
                if not member.startswith("_"):
                    yield pytest.param(value, id=f"{name}.{member}")


def test_the_page_is_written_from_the_docstrings() -> None:
    assert api_page.PAGE.read_text() == api_page.page(), "run: just docs"


def test_everything_public_is_on_the_page() -> None:
    text = api_page.page()
    for name in vlad_cell.__all__:
        assert f"## {name}\n" in text or f"| `{name}` |" in text, name
    for module, name in ((station, "Config"), (station, "Settings"), (job, "ToPick"), (job, "ToLay")):
        assert hasattr(module, name) and f"| `{name}` |" in text
    assert hasattr(pick, "Progress") and hasattr(said, "Said") and "| `Progress` |" in text and "| `Said` |" in text


@pytest.mark.parametrize("function", list(_functions()))
def test_a_docstring_tells_of_every_argument_or_where_they_are_told_of(function: Any) -> None:
    text = inspect.getdoc(function) or ""
    assert text
    names = [name for name in inspect.signature(function).parameters if name not in ("self", "timeout_s")]
    if re.search(r"the arguments and errors are those of|with its arguments and errors", text):
        return
    assert all(re.search(rf"\b{name}\b", text) for name in names), names
