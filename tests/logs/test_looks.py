"""Several looks in one recording: what came first is superseded; the page shows from where, why, what each added."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from bus import topics
from bus.messages import CameraModel, Detections, Frame, Observation, SeenMount
from logs.direction import direction_in_words
from logs.live_views import Views
from logs.mcap.reader import CycleRecord, read_cycle
from logs.report.cycle_report import write_report
from logs.report.day_report import INDEX, days, write_cycle, write_day
from logs.report.look_points import added_shares, points_of_things
from logs.report.looks import mount_in_words
from logs.report.timeline import summarize

WHY = "too little was seen"
MOUNT = SeenMount(
    color_from_corrected=np.eye(4) + 1e-3 * np.eye(4, k=3),
    turn_rad=0.0033,
    turn_deviation_rad=0.001,
    shift_m=0.0016,
    shift_deviation_m=0.002,
    residual_before_m=0.0023,
    residual_after_m=0.0007,
    is_cut=False,
    named="",
    table_tilt_rad=0.0,
    off_mounting=0.4,
)


@pytest.fixture
def twice(record: Callable[..., Path]) -> CycleRecord:
    """A cycle that looked twice, and worked in the second image; in the first the thing is in the same pixels."""
    told = read_cycle(record(again=WHY))
    detect = told.stages["detect"]
    assert isinstance(detect.result, Detections)
    scene = detect.result.scene
    scene = scene.model_copy(update={"shown": 1, "further_labels": (scene.labels,), "mount": MOUNT})
    found = detect.result.model_copy(update={"scene": scene})
    stages = {**told.stages, "detect": detect.model_copy(update={"result": found})}
    return replace(told, stages=stages, scene=scene)


def test_both_looks_are_read_in_order(twice: CycleRecord) -> None:
    assert [seen.view.why for seen in twice.looks] == ["", WHY]
    assert twice.observation is twice.looks[1]


def test_a_failure_that_another_look_followed_is_not_the_cycles(twice: CycleRecord) -> None:
    assert [stage.stage for stage in twice.superseded] == ["capture", "detect"]
    assert all(stage.failure is None for stage in twice.stages.values())
    timeline = summarize(twice)
    assert [line.name for line in timeline.stages][:5] == ["capture", "detect", "capture", "detect", "plan"]
    assert timeline.stages[1].said == "Too little of it was seen." and not any(one.failed for one in timeline.stages)
    assert timeline.stages[2].said == f"another look, tilt 45°, azimuth 90°: {WHY}"
    assert timeline.took_s["detect"] == pytest.approx(0.2 + 0.5)


def test_what_the_first_look_showed_is_kept_when_the_second_fails(record: Callable[..., Path]) -> None:
    told = read_cycle(record("capture", again="the best grasp scores only 0.50", found=True))
    assert len(told.looks) == 1 and told.scene is not None and told.observation is told.looks[0]
    assert "detect" not in told.stages


def test_the_page_shows_each_look_and_how_they_disagreed(twice: CycleRecord, tmp_path: Path) -> None:
    page = write_report(twice, tmp_path / "page.html").read_text()
    section = page[page.index('<section id="looks">') :].partition("</section>")[0]
    words = " ".join(unescape(re.sub(r"<[^>]*>", " ", section)).split())
    assert section.count("<img") == 2 and 'data-figure="looks"' in section
    assert "look 1 : from above, 0.20 s the look that every pick begins with" in words
    assert f"look 2 : tilt 45°, azimuth 90°, 0.50 s; detect worked in this image because {WHY}" in words
    assert "The looks disagreed by 2.3 mm, 0.7 mm after a correction" in words


def test_the_days_page_says_why_a_cycle_looked_again(record: Callable[..., Path], tmp_path: Path) -> None:
    write_cycle(record(again=WHY))
    (day,) = days(tmp_path)
    write_day(day)
    page = (day / INDEX).read_text()
    assert "2 looks" in page and f"looked again: {WHY}" in page


def test_each_look_adds_what_no_earlier_one_saw() -> None:
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10), [0.0]), axis=-1).reshape(-1, 3) * 0.004
    noisy = grid + np.random.default_rng(0).normal(0, 0.001, grid.shape)
    assert added_shares([grid, noisy, np.concatenate([noisy, grid + np.array([0.5, 0, 0])])]) == [0.5, 0.0, 0.5]
    assert added_shares([np.zeros((0, 3)), grid]) == [0.0, 1.0]
    assert added_shares([np.zeros((0, 3))] * 2) == [0.0, 0.0]


def test_the_points_of_things_are_in_base_by_the_corrected_pose(twice: CycleRecord) -> None:
    assert twice.scene is not None
    camera = CameraModel(width=80, height=72, fx=93.0, fy=93.0, cx=39.5, cy=35.5)
    labels = np.zeros((72, 80), dtype=np.uint8)
    labels[20:50, 30:50] = 1
    frame = Frame(
        stamp_ns=1,
        color=np.zeros((72, 80, 3), dtype=np.uint8),
        depth_m=np.where(labels > 0, 0.9, 1.0).astype(np.float32),
        color_camera=camera,
        depth_camera=camera,
        color_from_depth=np.eye(4),
    )
    above = np.diag([1.0, -1.0, -1.0, 1.0])
    above[2, 3] = 1.0
    view = twice.looks[0].view.model_copy(update={"stamp_ns": 1, "base_from_color": above})
    scene = twice.scene.model_copy(update={"shown": 0, "labels": labels, "further_labels": ()})
    points, none = points_of_things(scene, [Observation(view=view, frame=frame)] * 2)  # the second has no labels
    assert len(none) == 0
    assert np.allclose(points[:, 2], 0.1)
    assert points[:, 0].min() == pytest.approx(-9.5 / 93 * 0.9 + 0.001) and points[:, 0].max() < 0.0935


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "neither table nor mounting is off"),
        ({"named": "table", "table_tilt_rad": 0.035}, "the table is tilted (table 2.01°"),
        ({"named": "mount"}, "the camera's mounting is off: calibrate"),
        ({"color_from_corrected": np.eye(4)}, "would leave 0.7 mm"),
        ({"is_cut": True}, "the correction was cut"),
        ({"residual_before_m": None, "residual_after_m": None}, "no surface in common"),
    ],
)
def test_the_mounting_is_told_in_words(changes: dict[str, object], said: str) -> None:
    assert said in " ".join(mount_in_words(MOUNT.model_copy(update=changes)))


def test_directions_are_tilt_and_azimuth() -> None:
    assert direction_in_words(np.diag([1.0, -1.0, -1.0, 1.0])) == "from above"


def test_the_live_picture_has_the_stamp_of_the_look_it_shows(twice: CycleRecord) -> None:
    views = Views(lambda _: np.eye(4))
    first = twice.superseded[0]
    (log,) = (payload for topic, payload in views.of(first) if topic is topics.VIEW_LOG)
    assert topics.VIEW_LOG.says.FromString(log).message == "done in 0.20 s"
    (log,) = (payload for topic, payload in views.of(twice.stages["capture"]) if topic is topics.VIEW_LOG)
    assert topics.VIEW_LOG.says.FromString(log).message.startswith("another look, tilt 45°, azimuth 90°: too little")
    assert twice.scene is not None
    for shown, seen in enumerate(twice.looks):
        drawn = dict(views.of(twice.scene.model_copy(update={"shown": shown})))
        picture = topics.VIEW_COLOR.says.FromString(drawn[topics.VIEW_COLOR])
        assert picture.timestamp.ToNanoseconds() == seen.view.stamp_ns
