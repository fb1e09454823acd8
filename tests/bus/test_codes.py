"""The closed list of codes, and the words at the head of a result."""

from __future__ import annotations

import pytest

from bus.codes import ADVICE, Code, title_of, went_for


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


@pytest.mark.parametrize(
    ("code", "reason", "what"),
    [
        (Code.DROPPED, "Nothing here is 'purple'.", "spatula"),
        (Code.TARGET_NOT_FOUND, "Nothing here is 'purple'.", "'purple'"),
        (Code.TARGET_NOT_FOUND, 'The model does not see "ann\'s cup": there is none', '"ann\'s cup"'),
        (Code.TARGET_NOT_FOUND, "There is no object within 20 mm of (0.400, 0.100).", ""),
    ],
)
def test_a_cycle_that_found_nothing_of_the_kind_went_for_what_was_asked_for(code: str, reason: str, what: str) -> None:
    assert went_for(code, "spatula", reason) == what
