"""What the stages find is drawn in Foxglove's messages: in the right frame, at the frame's time, at its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bus import topics
from bus.codes import Code
from bus.commands import Event
from bus.messages import Detections, Frame
from bus.sensor_codec import stamp_ns
from logs.live_views import Views, pictures
from logs.mcap.reader import CycleRecord, read_cycle

Drawn = dict[str, list[Any]]


@pytest.fixture
def cycle(record: Callable[..., Path]) -> CycleRecord:
    return read_cycle(record())


@pytest.fixture
def drawn(cycle: CycleRecord) -> Drawn:
    """Every picture of one cycle, decoded, by its topic's key."""
    views = Views(lambda q_rad: np.diag([1.0, 1.0, 1.0, 1.0]) + np.eye(4, k=3) * q_rad[1])
    found: Drawn = {}
    for stage in cycle.stages.values():
        for topic, payload in views.of(stage):
            found.setdefault(topic.key, []).append(topic.says.FromString(payload))
    return found


def _detections(cycle: CycleRecord) -> Detections:
    found = cycle.stages["detect"].result
    assert isinstance(found, Detections)
    return found


def test_images_annotations_and_cloud_are_of_the_captured_frame(drawn: Drawn, cycle: CycleRecord, frame: Frame) -> None:
    found = _detections(cycle).evidence
    (color,), (goal,), (cloud,) = (
        drawn[topic.key] for topic in (topics.VIEW_COLOR, topics.VIEW_GOAL, topics.VIEW_CLOUD)
    )
    for image in (color, goal):
        pixels = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR)
        assert pixels is not None and pixels.shape == found.color.shape
        assert stamp_ns(image.timestamp) == frame.stamp_ns
    assert np.array_equal(np.frombuffer(cloud.data, "<f4").reshape(-1, 3), found.observed_points)
    assert (cloud.frame_id, cloud.point_stride, [field.name for field in cloud.fields]) == (
        "color",
        12,
        ["x", "y", "z"],
    )


def test_rectangles_have_their_corners_and_masks_their_outline(drawn: Drawn, frame: Frame) -> None:
    (annotations,) = drawn[topics.VIEW_ANNOTATIONS.key]
    rectangle, *outlines = annotations.points
    assert stamp_ns(rectangle.timestamp) == frame.stamp_ns
    corners = np.array([(point.x, point.y) for point in rectangle.points])
    assert np.allclose(corners.mean(axis=0), (75.0, 40.0))
    assert np.allclose(sorted(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)), (12, 12, 30, 30))
    outline = np.array([(point.x, point.y) for point in outlines[0].points])
    assert (outline.min(axis=0).tolist(), outline.max(axis=0).tolist()) == ([60.0, 30.0], [89.0, 49.0])


def test_every_thing_has_its_outline_and_its_number(drawn: Drawn) -> None:
    (annotations,) = drawn[topics.VIEW_ANNOTATIONS.key]
    corners = np.array([(point.x, point.y) for point in annotations.points[-1].points])
    assert (corners.min(axis=0).tolist(), corners.max(axis=0).tolist()) == ([60.0, 30.0], [89.0, 49.0])
    (number,) = annotations.texts
    assert number.text == "1" and 60 <= number.position.x <= 89 and 30 <= number.position.y <= 49


def test_what_a_failed_detection_saw_is_drawn_on_grey(cycle: CycleRecord, frame: Frame) -> None:
    views = Views(lambda _: np.eye(4))
    assert cycle.scene is not None
    list(views.of(cycle.stages["capture"]))
    drawn = {topic.key: topic.says.FromString(payload) for topic, payload in views.of(cycle.scene)}
    assert set(drawn) == {topics.VIEW_COLOR.key, topics.VIEW_ANNOTATIONS.key}
    picture, annotations = drawn[topics.VIEW_COLOR.key], drawn[topics.VIEW_ANNOTATIONS.key]
    pixels = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None and pixels.shape[:2] == cycle.scene.labels.shape
    assert np.ptp(pixels[45, 85].astype(int)) > 40 and np.ptp(pixels[70, 40].astype(int)) < 12  # coloured, grey
    assert stamp_ns(picture.timestamp) == stamp_ns(annotations.texts[0].timestamp) == frame.stamp_ns


def test_the_scene_has_rod_grasps_gripper_and_paths_each_in_its_frame(drawn: Drawn) -> None:
    entities = {entity.id: entity for scene in drawn[topics.VIEW_SCENE.key] for entity in scene.entities}
    frames = {name: entity.frame_id for name, entity in entities.items()}
    assert frames == {"rod": "color", "grasps": "base", "gripper": "base", "path/reach": "base"}
    assert len(entities["gripper"].cubes) == 3 and len(entities["path/reach"].lines[0].points) > 1


def test_stages_failures_and_events_are_in_the_log(
    cycle: CycleRecord, record: Callable[..., Path], drawn: Drawn
) -> None:
    assert [line.name for line in drawn[topics.VIEW_LOG.key]] == list(cycle.stages)
    views = Views(lambda _: np.eye(4))
    failed = read_cycle(record("detect", name="20260101T000000002")).stages["detect"]
    event = Event(code=Code.ARM_REFLEX, severity="error", text="It hit something.")
    lines = [topic.says.FromString(payload) for said in (failed, event) for topic, payload in views.of(said)]
    assert [line.name for line in lines] == ["detect", "ARM_REFLEX"]
    assert {line.level for line in lines} == {topics.VIEW_LOG.says.ERROR}


def test_nothing_is_drawn_of_anything_else() -> None:
    assert list(Views(lambda _: np.eye(4)).of(b"")) == []


def test_what_cannot_be_drawn_is_a_warning_and_never_an_error(cycle: CycleRecord) -> None:
    views = Views(lambda _: np.eye(4))
    detect = cycle.stages["detect"]
    detections = _detections(cycle)
    evidence = detections.evidence.model_copy(update={"goal_image": np.zeros((0, 0, 3), np.uint8)})
    nothing = detect.model_copy(update={"result": detections.model_copy(update={"evidence": evidence})})
    drawn = pictures(views.of, nothing)
    assert [topic for topic, _ in drawn] == [topics.VIEW_LOG, topics.VIEW_COLOR, topics.VIEW_LOG]
    said = topics.VIEW_LOG.says.FromString(drawn[-1][1])
    assert said.level == topics.VIEW_LOG.says.WARNING and "cannot be drawn" in said.message


def test_words_that_no_text_can_hold_are_written_out() -> None:
    ((_, payload),) = pictures(Views(lambda _: np.eye(4)).of, Event(code="X", severity="info", text="caf\udce9"))
    assert topics.VIEW_LOG.says.FromString(payload).message == "caf\\udce9"
