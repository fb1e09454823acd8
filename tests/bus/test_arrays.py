"""Arrays, images and bytes in messages: exact whatever the form, and a BadPayload whatever else arrives."""

from __future__ import annotations

import base64
import contextlib
import json
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bus import codec
from bus.arrays import Blob, ColorImage, Joints, JointSamples, Mask, Points, Transform
from bus.errors import BadPayload
from bus.frozen import Message

_FLOATS = hnp.array_shapes(min_dims=1, max_dims=1, min_side=0, max_side=20).map(lambda shape: (*shape, 7))


class Said(Message):
    """A message with one field of each kind."""

    samples: JointSamples | None = None
    joints: Joints | None = None
    points: Points | None = None
    pose: Transform | None = None
    color: ColorImage | None = None
    mask: Mask | None = None
    blob: Blob | None = None


def _there_and_back(said: Said) -> Said:
    return codec.decode(Said, codec.encode(said))


@given(hnp.arrays(np.float64, _FLOATS, elements=st.floats(width=64)))
def test_every_number_of_8_bytes_comes_back_bit_for_bit(samples: np.ndarray) -> None:
    back = _there_and_back(Said(samples=samples)).samples
    assert back is not None and back.dtype == np.float64 and back.shape == samples.shape
    assert back.tobytes() == samples.tobytes()


@given(hnp.arrays(np.float32, (5, 3), elements=st.floats(width=32)))
def test_every_number_of_4_bytes_comes_back_bit_for_bit(points: np.ndarray) -> None:
    back = _there_and_back(Said(points=points)).points
    assert back is not None and back.dtype == np.float32 and back.tobytes() == points.tobytes()


def test_a_short_array_travels_as_plain_lists() -> None:
    said = json.loads(codec.encode(Said(joints=np.arange(7) / 10, pose=np.eye(4))))
    assert said["joints"] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert said["pose"] == np.eye(4).tolist()


@pytest.mark.parametrize("samples", [np.zeros((10, 7)), np.zeros((0, 7)), np.full((1, 7), np.nan)])
def test_a_long_an_empty_or_an_infinite_one_travels_as_bytes(samples: np.ndarray) -> None:
    said = json.loads(codec.encode(Said(samples=samples)))
    assert said["samples"]["dtype"] == "<f8" and said["samples"]["shape"] == list(samples.shape)


def test_a_short_one_as_bytes_is_read_as_it_was_recorded_before() -> None:
    packed = {"dtype": "<f8", "shape": [7], "base64": base64.b64encode(np.arange(7.0).tobytes()).decode()}
    said = codec.decode(Said, json.dumps({"joints": packed}).encode())
    assert said.joints is not None and said.joints.tolist() == list(range(7))


def test_a_long_one_as_lists_is_read_and_an_empty_list_has_no_rows() -> None:
    said = codec.decode(Said, json.dumps({"samples": np.ones((100, 7)).tolist(), "points": []}).encode())
    assert said.samples is not None and said.samples.shape == (100, 7)
    assert said.points is not None and said.points.shape == (0, 3)


def test_the_schema_says_both_forms() -> None:
    lists, packed, _null = Said.model_json_schema()["properties"]["pose"]["anyOf"]
    assert lists["items"]["items"] == {"type": "number"} and lists["minItems"] == lists["items"]["maxItems"] == 4
    assert packed["required"] == ["dtype", "shape", "base64"]


def _png(width: int, height: int) -> str:
    """The beginning of a PNG that says it is of this size, with next to nothing in it."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    return base64.b64encode(png).decode()


def _bytes(**changed: Any) -> dict[str, Any]:
    return {"dtype": "<f8", "shape": [7], "base64": base64.b64encode(bytes(56)).decode(), **changed}


@pytest.mark.parametrize(
    "field",
    [
        {"joints": value}
        for value in [
            {}, {"dtype": "<f8"}, _bytes(dtype=5), _bytes(dtype=None), _bytes(dtype="O"), _bytes(dtype="f8,f8"),
            _bytes(dtype="("), _bytes(dtype="<c16"), _bytes(shape="abc"), _bytes(shape=[-1]), _bytes(shape=[7.0]),
            _bytes(shape=[True]), _bytes(shape=[10**30]), _bytes(shape=[0, 10**30]), _bytes(shape=None),
            _bytes(shape=[1, 7]), _bytes(shape=[[7]]), _bytes(base64=7), _bytes(base64="?"), _bytes(base64="é"),
            _bytes(base64=None), _bytes(base64="AA=="), _bytes(more=1), [None] * 7, ["1"] * 7, [{}] * 7, [[]] * 7,
            [1, 2], [1, [2]], [True] * 7, [10**400] * 7, "1234567", 7, True, [[0.0] * 7], [],
        ]
    ]
    + [{"points": [[1e300, 0, 0]]}]
    + [
        {image: value}
        for image in ("color", "mask")
        for value in [
            {}, {"png": 5}, {"png": None}, {"png": ""}, {"png": "?"}, {"png": "AAAA"}, {"png": _png(4, 4)},
            {"png": _png(2**31 - 1, 2**31 - 1)}, {"png": _png(100_000, 100_000)}, {"png": _png(0, 4)}, [[1]], "x", 5,
        ]
    ]
    + [{"blob": value} for value in (10**12, -1, 3.5, ["a"], {"a": 1}, "?", True)],
    ids=lambda field: json.dumps(field)[:60],
)  # fmt: skip
def test_what_is_no_array_is_a_bad_payload_that_names_the_field(field: dict[str, Any]) -> None:
    with pytest.raises(BadPayload, match=next(iter(field))):
        codec.decode(Said, json.dumps(field).encode())


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
)
_PACKED = st.fixed_dictionaries({"dtype": _JSON, "shape": _JSON, "base64": _JSON})


@given(st.sampled_from(list(Said.model_fields)), _JSON | _PACKED | st.fixed_dictionaries({"png": _JSON}))
def test_anything_else_is_read_or_a_bad_payload(field: str, value: Any) -> None:
    with contextlib.suppress(BadPayload):
        codec.decode(Said, json.dumps({field: value}).encode())


def test_gray_pixels_are_no_colours_and_a_colour_image_is_no_mask() -> None:
    gray = json.loads(codec.encode(Said(mask=np.ones((4, 4), np.bool_))))["mask"]
    color = json.loads(codec.encode(Said(color=np.zeros((4, 4, 3), np.uint8))))["color"]
    for field, value in (("color", gray), ("mask", color)):
        with pytest.raises(BadPayload, match="channel"):
            codec.decode(Said, json.dumps({field: value}).encode())
