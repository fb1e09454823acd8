"""Messages to bytes and back."""

from __future__ import annotations

import numpy as np
import pytest
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bus import codec, sensor_codec, topics
from bus.errors import BadPayload
from bus.messages import ArmMode, ArmState, Frame, HandState, View
from bus.trajectory import Trajectory


def test_a_frame_survives_the_wire(frame: Frame) -> None:
    back = sensor_codec.frame_from_wire(sensor_codec.frame_to_wire(frame))
    assert back.stamp_ns == frame.stamp_ns
    assert back.color_camera == frame.color_camera and back.depth_camera == frame.depth_camera
    np.testing.assert_allclose(back.color_from_depth, frame.color_from_depth, atol=1e-12)
    np.testing.assert_allclose(back.depth_m, frame.depth_m, atol=1e-6)  # whole millimetres are exact; NaN stays NaN
    assert np.abs(back.color.astype(int) - frame.color).max() <= 3  # JPEG


def test_decoding_the_same_bytes_twice_gives_the_same_frame(frame: Frame) -> None:
    parts = sensor_codec.frame_to_wire(frame)
    first, second = sensor_codec.frame_from_wire(parts), sensor_codec.frame_from_wire(parts)
    assert first.model_dump_json() == second.model_dump_json()


@pytest.mark.parametrize("missing", [topic.key for topic in topics.FRAME_PARTS])
def test_an_incomplete_frame_names_what_is_missing(frame: Frame, missing: str) -> None:
    parts = sensor_codec.frame_to_wire(frame)
    del parts[missing]
    with pytest.raises(BadPayload, match=missing):
        sensor_codec.frame_from_wire(parts)


def test_parts_of_two_frames_are_refused(frame: Frame) -> None:
    parts = sensor_codec.frame_to_wire(frame)
    later = sensor_codec.frame_to_wire(frame.model_copy(update={"stamp_ns": frame.stamp_ns + 1}))
    with pytest.raises(BadPayload, match="different stamps"):
        sensor_codec.frame_from_wire({**parts, topics.CAMERA_DEPTH.key: later[topics.CAMERA_DEPTH.key]})


@pytest.mark.parametrize("part", [topic.key for topic in topics.FRAME_PARTS])
def test_a_damaged_part_is_a_bad_payload(frame: Frame, part: str) -> None:
    parts = sensor_codec.frame_to_wire(frame)
    with pytest.raises(BadPayload):
        sensor_codec.frame_from_wire({**parts, part: parts[part][: len(parts[part]) // 2]})


@given(hnp.arrays(np.float64, (3, 7), elements=st.floats(-3, 3, allow_nan=False)))
def test_trajectories_travel_bit_for_bit(q_rad: np.ndarray) -> None:
    sent = Trajectory(raw_q_rad=q_rad, window=4)
    received = codec.decode(Trajectory, codec.encode(sent))
    assert received.raw_q_rad.tobytes() == sent.raw_q_rad.tobytes()


@pytest.mark.parametrize(
    ("payload", "names"),
    [
        (b"not json", "Invalid JSON"),
        (b"{}", "stamp_ns"),
        (b'{"stamp_ns": 1, "width_m": "wide", "is_moving": false, "is_homed": true}', "width_m"),
        (b'{"stamp_ns": 1, "width_m": 0.1, "is_moving": false, "is_homed": true, "color": "red"}', "color"),
    ],
)
def test_a_payload_that_does_not_fit_names_the_field(payload: bytes, names: str) -> None:
    with pytest.raises(BadPayload, match=names):
        codec.decode(HandState, payload)


def test_a_view_from_a_mirrored_camera_is_a_bad_payload_that_says_so() -> None:
    rest = np.zeros(7)
    arm = ArmState(stamp_ns=1, mode=ArmMode.IDLE, q_rad=rest, dq_rad_s=rest, tau_ext_nm=rest)
    view = View(stamp_ns=1, arm=arm, base_from_color=np.eye(4))
    with pytest.raises(BadPayload, match=r"Not a valid View: View.base_from_color mirrors.* docs/bus\.md"):
        codec.decode(View, codec.encode(view.model_copy(update={"base_from_color": np.diag([1.0, 1.0, -1.0, 1.0])})))


def test_arrays_in_messages_are_read_only() -> None:
    trajectory = Trajectory(raw_q_rad=np.zeros((2, 7)), window=1)
    with pytest.raises(ValueError, match="read-only"):
        trajectory.raw_q_rad[0, 0] = 1.0


@pytest.mark.parametrize("encoding", sorted(topics.types_by_encoding()))
def test_every_encoding_of_the_table_has_a_schema(encoding: str) -> None:
    schema = codec.schema_of(encoding)
    assert schema.name == encoding.partition(";")[2] and len(schema.data) > 100
    if schema.encoding == "protobuf":
        assert GetMessageClass(topics.types_by_encoding()[encoding].DESCRIPTOR).DESCRIPTOR.full_name == schema.name


def test_an_unknown_encoding_is_refused() -> None:
    with pytest.raises(BadPayload, match=r"vlad\.Nonsense"):
        codec.schema_of("application/json;vlad.Nonsense")


def test_no_key_is_used_twice_for_the_same_kind() -> None:
    rows = [(topic.key, topic.kind) for topic in topics.TOPICS]
    assert len(rows) == len(set(rows)) > 20
