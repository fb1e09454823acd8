"""Reads a picture file's size and end from its structure, so that it is judged before it is decoded.

Decoders fill missing data silently, and allocate the memory that a head names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from bus.errors import BadPayload

MAX_PIXELS = 1 << 26
"""67 million, twice the pixels of an 8K image; as RGB they take 200 MB."""
_PNG, _PNG_HEAD, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IHDR", b"IEND"
_JPEG = b"\xff\xd8"
_JPEG_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_JPEG_SCAN, _JPEG_END = 0xDA, 0xD9
_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")
"""In a scan, 0xff followed by a zero or a restart number is not a marker."""


class Size(NamedTuple):
    """Width and height of a picture [px]."""

    width: int
    height: int


def require_picture(data: bytes) -> Size:
    """Return the size of a PNG or JPEG file, read from its head. Raises: BadPayload: another file, too many pixels."""
    size = None if _is_webp(data) else size_of(data)
    if size is None:
        raise BadPayload("An image is neither PNG nor JPEG, damaged, or cut off.")
    if not 0 < size.width * size.height <= MAX_PIXELS:
        raise BadPayload(
            f"An image says that it has {size.width} x {size.height} pixels; at most {MAX_PIXELS} are taken."
        )
    return size


def size_of(data: bytes) -> Size | None:
    """Return the size that the head of a PNG, JPEG or WebP file names; None for another file, or a torn head."""
    if data.startswith(_PNG):
        return _png_size(data)
    if data.startswith(_JPEG):
        return _jpeg_size(data)
    return _webp_size(data) if _is_webp(data) else None


def is_whole(data: bytes) -> bool:
    """Whether a PNG, JPEG or WebP file reaches its end; data after the end is ignored."""
    if data.startswith(_PNG):
        return any(kind == _PNG_END and end <= len(data) for kind, _, end in _png_chunks(data))
    if data.startswith(_JPEG):
        markers = [marker for marker, _ in _jpeg_segments(data)]
        return _JPEG_SCAN in markers and markers[-1] == _JPEG_END
    return _is_webp(data) and len(data) >= 8 + int.from_bytes(data[4:8], "little")


def _png_size(data: bytes) -> Size | None:
    for kind, start, _ in _png_chunks(data):
        if kind == _PNG_HEAD and start + 8 <= len(data):
            return Size(int.from_bytes(data[start : start + 4]), int.from_bytes(data[start + 4 : start + 8]))
    return None


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Each chunk's kind, and where its content starts and its checksum ends."""
    at = len(_PNG)
    while at + 8 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4])
        yield data[at + 4 : at + 8], at + 8, end
        at = end


def _jpeg_size(data: bytes) -> Size | None:
    for marker, start in _jpeg_segments(data):
        if marker in _JPEG_SIZES and start + 7 <= len(data):
            return Size(int.from_bytes(data[start + 5 : start + 7]), int.from_bytes(data[start + 3 : start + 5]))
    return None


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Each segment's marker, and where its length stands; to the end of the image, or until something else is there."""
    at, in_scan = len(_JPEG), False
    while (found := _MARKER.search(data, at)) is not None and (in_scan or found.start() == at):
        marker, at = found.group(1)[0], found.end()
        yield marker, at
        if marker == _JPEG_END:
            return
        in_scan = in_scan or marker == _JPEG_SCAN
        at += int.from_bytes(data[at : at + 2])


def _is_webp(data: bytes) -> bool:
    return data[:4] == b"RIFF" and data[8:12] == b"WEBP"


def _webp_size(data: bytes) -> Size | None:
    kind, head = data[12:16], data[20:30]
    if len(head) < 10:
        return None
    if kind == b"VP8X":
        return Size(1 + int.from_bytes(head[4:7], "little"), 1 + int.from_bytes(head[7:10], "little"))
    if kind == b"VP8 ":
        sides = (int.from_bytes(head[start : start + 2], "little") & 0x3FFF for start in (6, 8))
        return Size(*sides)
    bits = int.from_bytes(head[1:5], "little")
    return Size(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)) if kind == b"VP8L" else None
