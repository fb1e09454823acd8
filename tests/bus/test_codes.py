"""The closed list of codes, and the words at the head of a result."""

from __future__ import annotations

import pytest

from bus.codes import ADVICE, Code, title_of


def test_every_code_has_advice() -> None:
    assert all(ADVICE[code].endswith(".") for code in Code)


@pytest.mark.parametrize(
    ("result", "code", "title"),
    [
        ("SUCCESS", "", "SUCCESS spatula"),
        ("FAILED", Code.DROPPED, "FAILED DROPPED spatula"),
        ("FAILED", Code.TARGET_NOT_FOUND, "FAILED TARGET_NOT_FOUND"),
    ],
)
def test_what_was_not_found_is_not_called_by_the_name_of_the_object_that_was_there(
    result: str, code: str, title: str
) -> None:
    assert title_of(result, code, "spatula") == title
