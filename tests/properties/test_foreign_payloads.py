"""Whatever bytes travel under a name of ours: they are read, or refused by their type; nothing else ever happens."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus import sensor_codec, topics
from bus.codec import decode
from bus.errors import BadFrame, BadPayload
from bus.frozen import Message
from bus.messages import CameraModel, Frame
from bus.picture_header import require_picture

TYPES = sorted(
    {kind for kind in topics.types_by_encoding().values() if isinstance(kind, type) and issubclass(kind, Message)},
    key=lambda kind: kind.__name__,
)
NUMBERS = st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e308, -1e308, float("nan"), float("inf"), -float("inf")])
ARRAYS = st.fixed_dictionaries(
    {},
    optional={
        "dtype": st.sampled_from(["<f8", "|b1", "O", "(1,2", ",", "M8", "", 5, None]),
        "shape": st.lists(st.integers(-2, 2**40), max_size=3) | st.just("abc"),
        "base64": st.sampled_from(["", "AAAAAAAAAAA=", "=", "ä", 7]),
        "png": st.sampled_from(["", "iVBORw0KGgo=", "=", 7]),
    },
)
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | ARRAYS
JSON = st.recursive(LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner))
ODD_JSON = (
    b"", b"\xff", b"\xef\xbb\xbf{}", b"[" * 100_000, b'{"a":' * 100_000, b"1" * 10_000, b'{"a": 1, "a": 2}', b"null",
    b'{"cycle_id": "\\ud800"}', b'{"stamp_ns": 1e999}', b"{" + b'"[/red]\\n": 1,' * 100 + b'"a": 1}', b"NaN",
)  # fmt: skip


def _read_or_refused(read: Callable[[], Any]) -> None:
    with suppress(BadPayload, BadFrame):
        read()


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
def test_json_of_any_shape_fits_a_message_or_is_refused(kind: type[Message]) -> None:
    for payload in ODD_JSON:
        with pytest.raises(BadPayload) if kind.model_fields else suppress(BadPayload) as refused:
            decode(kind, payload)
        assert refused is None or str(refused.value).isprintable()

    @settings(max_examples=10)
    @given(st.fixed_dictionaries(dict.fromkeys(kind.model_fields, JSON)) | JSON)
    def any_values(tree: Any) -> None:
        _read_or_refused(lambda: decode(kind, json.dumps(tree).encode()))

    any_values()


def _frame() -> Frame:
    camera = CameraModel(width=8, height=6, fx=5, fy=5, cx=4, cy=3)
    pose = np.eye(4)
    color, depth_m = np.zeros((6, 8, 3), np.uint8), np.ones((6, 8), np.float32)
    return Frame(
        stamp_ns=1, color=color, depth_m=depth_m, color_camera=camera, depth_camera=camera, color_from_depth=pose
    )


PARTS = sensor_codec.frame_to_wire(_frame())
COLOR, DEPTH, COLOR_LENS, DEPTH_LENS, TF = (topic.key for topic in topics.FRAME_PARTS)


def _changed(key: str, change: Callable[[Any], Any]) -> dict[str, bytes]:
    """The frame's payloads, with the fields of one of them changed."""
    says = next(topic.says for topic in topics.FRAME_PARTS if topic.key == key)
    message = says.FromString(PARTS[key])
    change(message)
    return {**PARTS, key: message.SerializeToString()}


def _set(path: str, value: Any) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        *way, last = path.split(".")
        for name in way:
            message = message.transforms[0] if name == "transforms" else getattr(message, name)
        if isinstance(value, list):
            del getattr(message, last)[:]
            getattr(message, last).extend(value)
        else:
            setattr(message, last, value)

    return change


NO_FRAMES = [
    (TF, "transforms.rotation.w", 0.0),
    (TF, "transforms.rotation.w", 2.0),
    (TF, "transforms.rotation.x", float("nan")),
    (TF, "transforms.translation.x", float("inf")),
    (TF, "transforms", []),
    (DEPTH_LENS, "K", []),
    (DEPTH_LENS, "K", [0.0] * 9),
    (COLOR_LENS, "K", [float("nan")] * 9),
    (COLOR_LENS, "D", [1.0]),
    (COLOR_LENS, "D", [float("inf")] * 8),
    (COLOR_LENS, "width", 2**32 - 1),
    (DEPTH_LENS, "height", 5),
    (DEPTH, "width", 2**32 - 1),
    (DEPTH, "height", 0),
    (DEPTH, "data", b""),
    (DEPTH, "encoding", "32FC1"),
    (COLOR, "data", b""),
    (COLOR, "data", b"\xff\xd8\xff\xc0"),
    (COLOR, "timestamp.seconds", -1),
    (COLOR, "timestamp.nanos", 2**31 - 1),
]


def test_the_frame_that_the_others_are_made_of_is_one() -> None:
    assert sensor_codec.frame_from_wire(PARTS).color.shape == (6, 8, 3)


@pytest.mark.parametrize(("key", "path", "value"), NO_FRAMES, ids=[f"{key} {path}" for key, path, _ in NO_FRAMES])
def test_what_is_no_frame_is_refused(key: str, path: str, value: Any) -> None:
    with pytest.raises(BadPayload) as refused:
        sensor_codec.frame_from_wire(_changed(key, _set(path, value)))
    assert str(refused.value).isprintable()


@settings(max_examples=200)
@given(st.sampled_from(sorted(PARTS)), st.data())
def test_any_bytes_for_a_part_are_read_or_refused(key: str, data: st.DataObject) -> None:
    whole = PARTS[key]
    at = data.draw(st.integers(0, len(whole) - 1))
    other = data.draw(st.binary(max_size=20))
    _read_or_refused(
        lambda: sensor_codec.frame_from_wire({**PARTS, key: whole[:at] + other + whole[at + len(other) :]})
    )


@given(st.sampled_from([COLOR_LENS, DEPTH_LENS]), st.lists(NUMBERS, max_size=10), st.lists(NUMBERS, max_size=9))
def test_any_numbers_for_a_lens_are_read_or_refused(key: str, k: list[float], d: list[float]) -> None:
    def change(message: Any) -> None:
        _set("K", k)(message)
        _set("D", d)(message)

    _read_or_refused(lambda: sensor_codec.frame_from_wire(_changed(key, change)))


@given(st.binary(max_size=60))
def test_any_bytes_are_an_arm_state_or_are_refused(payload: bytes) -> None:
    _read_or_refused(lambda: sensor_codec.arm_stamp_ns(payload))
    _read_or_refused(lambda: sensor_codec.arm_q_rad(payload))


@given(st.sampled_from([b"\xff\xd8", b"\x89PNG\r\n\x1a\n", b""]), st.binary(max_size=40))
def test_the_size_of_any_picture_is_known_or_it_is_refused(start: bytes, rest: bytes) -> None:
    _read_or_refused(lambda: require_picture(start + rest))


def test_a_picture_that_would_fill_the_memory_is_refused_by_its_head() -> None:
    png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (60_000).to_bytes(4) * 2
    jpeg = b"\xff\xd8\xff\xe0\0\x02\xff\xc0\0\x11\x08" + (60_000).to_bytes(2) * 2
    for picture in (png, jpeg):
        with pytest.raises(BadPayload, match="60000 x 60000"):
            require_picture(picture)
