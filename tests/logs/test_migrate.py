"""Recordings of older versions are read as if they were written today; the golden files are what those versions wrote.

They are real cycles of the simulated cell, its cameras at half their resolution.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from bus.codes import Code
from bus.errors import RecordingError
from bus.messages import Detections
from logs.mcap.migrate import MIGRATIONS, SCHEMA_VERSION, Content, migrate
from logs.mcap.reader import read_cycle

GOLDEN = Path(__file__).parent.parent / "golden"
STAGES = ["capture", "detect", "plan", "execute", "verify", "deliver"]


@pytest.mark.parametrize("version", [1, 2, 4])
def test_a_recording_of_an_older_version_is_read_whole(version: int) -> None:
    cycle = read_cycle(GOLDEN / f"cycle-schema{version}.mcap")
    assert list(cycle.stages) == STAGES and all(stage.result for stage in cycle.stages.values())
    assert cycle.observation is not None and cycle.after is not None and cycle.replies
    assert cycle.result is not None and cycle.result.result == cycle.metadata["result"] == "SUCCESS"
    assert cycle.metadata["schema"] == str(SCHEMA_VERSION) and cycle.metadata["dirty"] in ("no", "yes", "unknown")
    assert cycle.metadata["commit"].isalnum()


def test_since_schema_3_a_failed_plan_lists_what_it_rejected() -> None:
    failure = read_cycle(GOLDEN / "cycle-schema3.mcap").stages["plan"].failure
    assert failure is not None and failure.code is Code.COLLISION
    assert f"None of {len(failure.rejected)} ways to grasp" in failure.text
    assert {one.reason for one in failure.rejected} == {
        f"approach: {finger} finger touches an observed obstacle" for finger in ("left", "right")
    }


@pytest.mark.parametrize("version", [1, 2])
def test_before_schema_4_the_scene_is_the_one_object_that_was_seen(version: int) -> None:
    found = read_cycle(GOLDEN / f"cycle-schema{version}.mcap").stages["detect"].result
    assert isinstance(found, Detections) and [one.number for one in found.scene.instances] == [1]
    assert np.array_equal(found.scene.labels == 1, found.evidence.object_mask)
    assert {grasp.instance for grasp in found.grasps} == {1}


def test_before_schema_5_no_approach_was_felt_and_nothing_carried_calmly() -> None:
    content = Content(metadata={"schema": "4"}, station={"cell_id": "sim"})
    migrate(content)
    assert content.station == {
        "cell_id": "sim",
        "execute": {"contact_n": 0.0, "beside_m": 0.0},
        "planning": {"max_held_acceleration_m_s2": None},
    }


def test_before_schema_6_an_approach_passed_things_at_full_speed() -> None:
    content = Content(metadata={"schema": "5"}, station={"execute": {"contact_n": 5.0}})
    migrate(content)
    assert content.station == {"execute": {"contact_n": 5.0, "beside_m": 0.0}}


def test_every_channel_has_a_schema_and_foxgloves_are_named_so() -> None:
    with max(GOLDEN.glob("cycle-schema*.mcap")).open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert schema.data
        assert schema.name.startswith({"protobuf": "foxglove.", "jsonschema": "vlad."}[schema.encoding])
    shown = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert shown.items() >= {
        "/camera/color": "foxglove.CompressedImage",
        "/camera/depth": "foxglove.RawImage",
        "/camera/depth/calibration": "foxglove.CameraCalibration",
        "/arm/state": "foxglove.JointStates",
        "/tf": "foxglove.FrameTransforms",
        "/view/color": "foxglove.CompressedImage",
        "/view/goal": "foxglove.CompressedImage",
        "/view/annotations": "foxglove.ImageAnnotations",
        "/view/cloud": "foxglove.PointCloud",
        "/view/scene": "foxglove.SceneUpdate",
        "/view/log": "foxglove.Log",
    }.items()  # fmt: skip


def test_a_file_without_a_version_is_of_before_there_was_one() -> None:
    content = Content(metadata={"commit": "0123abc+"})
    migrate(content)
    assert content.metadata == {"commit": "0123abc", "dirty": "yes", "schema": str(SCHEMA_VERSION)}


@pytest.mark.parametrize("said", [str(SCHEMA_VERSION + 1), "-1", "two", ""])
def test_a_version_nobody_knows_is_refused(said: str) -> None:
    with pytest.raises(RecordingError, match="schema version"):
        migrate(Content(metadata={"schema": said}))


def test_there_is_one_migration_from_every_version() -> None:
    assert [migration.since for migration in MIGRATIONS] == list(range(SCHEMA_VERSION))
