"""A model's picture as a file: what is readable is read, and what is not is refused before it takes memory."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.codes import Code
from bus.errors import CycleFailure
from bus.picture_header import is_whole, size_of
from perception.geometry.window import Window, decode_picture

WINDOW = Window(0, 0, 128)
PICTURE = np.full((256, 256, 3), 40, np.uint8)
PICTURE[64:192, 64:192] = 200, 120, 30
MODES = {
    "png": (".png", []),
    "jpeg": (".jpg", []),
    "progressive": (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    "webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 90]),
    "lossless": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
}


def file(how: str, picture: np.ndarray = PICTURE) -> bytes:
    extension, options = MODES[how]
    return bytes(cv2.imencode(extension, picture, options)[1])


def refusal(data: bytes) -> str:
    with pytest.raises(CycleFailure) as failure:
        decode_picture(data, WINDOW)
    assert failure.value.failure is Code.MODEL_BAD_IMAGE
    return failure.value.text


@pytest.mark.parametrize("behind", [b"", b"\0\0\0", b"\r\n", b"and a \xff\xd8\xff comment"])
@pytest.mark.parametrize("how", MODES)
def test_whole_files_are_read_whatever_stands_behind_their_end(how: str, behind: bytes) -> None:
    data = file(how) + behind
    assert size_of(data) == (256, 256) and is_whole(data)
    assert np.abs(decode_picture(data, WINDOW)[64, 64].astype(int) - (30, 120, 200)).max() < 12


@pytest.mark.parametrize("how", MODES)
def test_torn_files_are_refused(how: str) -> None:
    data = file(how)
    for end in (10, len(data) // 2, len(data) - 1):
        assert "torn" in refusal(data[:end])


def test_what_is_transparent_shows_the_background() -> None:
    cut_out = cv2.cvtColor(PICTURE, cv2.COLOR_BGR2BGRA)
    cut_out[:64] = 0
    drawn = decode_picture(file("png", cut_out), WINDOW, (255, 250, 240))
    assert tuple(drawn[2, 64]) == (255, 250, 240) and tuple(drawn[64, 64]) == (30, 120, 200)


def test_a_header_that_asks_for_all_memory_is_refused_unpacked() -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 25_000, 25_000, 8, 2, 0, 0, 0))
    bomb = b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    assert "25000 x 25000 pixels; it is not unpacked" in refusal(bomb)


def test_a_small_picture_and_one_that_is_no_square_are_told_apart() -> None:
    assert "64 x 64 pixels; it has at least 128 a side" in refusal(file("png", PICTURE[:64, :64]))
    assert "256 x 128 pixels; a square was asked for" in refusal(file("png", PICTURE[:128]))


@given(
    data=st.binary(max_size=64),
    begin=st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"RIFF\4\0\0\0WEBP"]),
)
@settings(max_examples=100, deadline=None)
def test_no_bytes_end_in_anything_but_a_refusal(data: bytes, begin: bytes) -> None:
    assert refusal(begin + data)
