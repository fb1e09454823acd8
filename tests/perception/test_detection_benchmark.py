"""What the benchmark of detection reads in the model's replies."""

from __future__ import annotations

import pytest

from benchmarks.detection import spoken_width_m
from bus.codes import Code
from bus.messages import ModelReply


def _reason(text: str, failure: Code | None = None) -> ModelReply:
    return ModelReply(step="reason", sample=0, model="geometric", prompt="?", text=text, failure=failure)


def test_a_thing_without_an_axis_before_the_chosen_one_names_no_width() -> None:
    replies = [
        _reason("", Code.NO_GRASP),
        _reason("The object is 69 mm high. Two opposite faces 12.0 mm apart fit the jaw."),
    ]
    assert spoken_width_m(replies) == pytest.approx(0.012)
