"""Reads the size of a picture from its file header, so that an oversized one is refused before it is decoded."""

from __future__ import annotations

import struct

from bus.errors import BadPayload

MAX_PIXELS = 1 << 26
"""67 million, twice the pixels of an 8K image; as RGB they take 200 MB."""
_PNG_HEAD = struct.Struct(">8sI4sII")
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_SEGMENT = struct.Struct(">BBH")
_SIZE = struct.Struct(">BHH")
_NO_SIZE = (0xC4, 0xC8, 0xCC)  # markers of tables, among those that begin a frame


def require_picture(data: bytes) -> tuple[int, int]:
    """Return (width, height) [px] of a PNG or JPEG file. Raises: BadPayload for another file, or too many pixels."""
    try:
        width, height = _png(data) if data.startswith(_SIGNATURE) else _jpeg(data)
    except (struct.error, IndexError) as error:
        raise BadPayload("An image is neither PNG nor JPEG, or cut off.") from error
    if not 0 < width * height <= MAX_PIXELS:
        raise BadPayload(f"An image says that it has {width} x {height} pixels; at most {MAX_PIXELS} are taken.")
    return width, height


def _png(data: bytes) -> tuple[int, int]:
    *_, width, height = _PNG_HEAD.unpack_from(data)
    return width, height


def _jpeg(data: bytes) -> tuple[int, int]:
    """Read the size from the first segment that begins a frame."""
    if data[:2] != b"\xff\xd8":
        raise BadPayload("An image is neither PNG nor JPEG.")
    start = 2
    while True:
        mark, kind, length = _SEGMENT.unpack_from(data, start)
        if mark != 0xFF or length < 2:
            raise BadPayload("A JPEG image is damaged.")
        if kind == 0xFF:  # fill byte
            start += 1
        elif 0xC0 <= kind <= 0xCF and kind not in _NO_SIZE:
            _, height, width = _SIZE.unpack_from(data, start + _SEGMENT.size)
            return width, height
        else:
            start += 2 + length
