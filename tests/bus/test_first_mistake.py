"""The sentence about the first mistake of a message: the field's full name, and why it does not fit."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from bus.first_mistake import first_mistake
from bus.messages import Job, Target


def mistake_in(values: dict[str, object]) -> ValidationError:
    with pytest.raises(ValidationError) as caught:
        Job.model_validate(values)
    return caught.value


def test_a_field_is_named_in_full() -> None:
    error = mistake_in({"target": {"pixel": [3, "x"]}})
    assert first_mistake(error).startswith("target.pixel.1: Input should be a valid number")
    assert first_mistake(error, inside="job").startswith("job.target.pixel.1: ")


def test_our_own_checks_speak_for_themselves() -> None:
    says = "a target is named by text, pixel, box or point_m: by one of them"
    assert first_mistake(mistake_in({"target": {}})) == f"target: {says}"


def test_a_mistake_of_no_field_has_the_name_that_it_is_given() -> None:
    with pytest.raises(ValidationError) as caught:
        Target()
    assert first_mistake(caught.value, whole="the job").startswith("the job: a target")
    assert first_mistake(caught.value).startswith("a target")
