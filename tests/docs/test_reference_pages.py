"""The pages that are written from the code: up to date, and complete."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import pytest
from mcap.reader import make_reader
from pydantic import Field

from bus.arrays import JointSamples, Mask
from bus.frozen import Message
from bus.topics import TOPICS
from config.load import load_station
from docs import bus_page, catalogue_page, export_page, recording_page, settings_page
from docs.fields import Row, lead, rows

GOLDEN = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"


@pytest.mark.parametrize(
    "of", [bus_page, settings_page, recording_page, catalogue_page, export_page], ids=lambda of: of.PAGE.name
)
def test_a_page_is_written_from_the_code(of: ModuleType) -> None:
    assert of.PAGE.read_text() == of.page(), "run: just docs"


def test_every_topic_is_on_the_bus_page() -> None:
    text = bus_page.page()
    assert all(f"| `{topic.key}` |" in text for topic in TOPICS)


def test_every_message_that_is_named_on_the_bus_page_is_explained_there() -> None:
    text = bus_page.page()
    heads = [line.lstrip("# ") for line in text.splitlines() if line.startswith("##")]
    anchors = {head.lower().replace(" ", "-") for head in heads}
    named = {part.partition(")")[0] for part in text.split("](#")[1:]}
    assert named and named <= anchors


def test_every_setting_of_a_station_is_on_the_settings_page() -> None:
    text = settings_page.page()
    for name, table in load_station().model_dump().items():
        for setting in table if isinstance(table, dict) and name != "nodes" else [name]:
            heads = (f"`{setting}`", f".{setting}]", f"[{setting}.NAME]", f"[{setting}]")
            assert any(head in text for head in heads), setting


def test_every_channel_of_a_recorded_cycle_is_on_the_recording_page() -> None:
    text = recording_page.page().replace("{name}", "sim")
    with GOLDEN.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    missing = [channel.topic for channel in summary.channels.values() if f"`{channel.topic}`" not in text]
    assert not missing


class _Told(Message):
    """How it was told. ``mask``: where.

    Attributes:
        count, rate_hz: how many; ``word``: which of two.
            It is lower case.
    """

    count: Annotated[int, Field(ge=1, le=8)] = 3
    rate_hz: float
    word: Literal["one", "two"] = "one"
    samples: JointSamples
    """What was measured | planned."""
    mask: Mask
    names: tuple[str, ...] = ()
    at_px: tuple[float, float] | None = None


def test_a_field_is_shown_with_its_type_its_limits_its_default_and_what_the_docstrings_say_of_it() -> None:
    assert lead(_Told) == "How it was told."
    assert list(rows(_Told, str)) == [
        Row("count", "integer", "≥ 1, ≤ 8", "3", "How many"),
        Row("rate_hz", "number", "", None, "How many"),
        Row("word", "`one` or `two`", "", '"one"', "Which of two. It is lower case."),
        Row("samples", "array n x (6 to 7)", "", None, "What was measured \\| planned."),
        Row("mask", "PNG image", "", None, "Where."),
        Row("names", "list of string", "", "[]", ""),
        Row("at_px", "2 x number or null", "", "null", ""),
    ]


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("speed_m_s", "m/s"),
        ("size_m", "m"),
        ("speed_rad_s", "rad/s"),
        ("patience_s", "s"),
        ("joint_stiffness_nm_rad", "Nm/rad"),
        ("seed", ""),
    ],
)
def test_a_settings_unit_is_the_end_of_its_name(name: str, unit: str) -> None:
    assert settings_page.unit(name) == unit


@pytest.mark.parametrize("of", [bus_page, settings_page], ids=lambda of: of.PAGE.name)
def test_every_field_has_a_meaning(of: ModuleType) -> None:
    """Pages and JSON schemas show it."""
    silent = [line for line in of.page().splitlines() if re.match(r"\| `.*\| *\|$", line)]
    assert not silent
