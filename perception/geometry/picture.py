"""Reads the size of a picture file from its structure before decoding, and detects torn files.

Decoders fill missing data silently, and allocate the memory that a header names.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_PNG, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND"
_JPEG = b"\xff\xd8\xff"
_JPEG_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_JPEG_SCAN, _JPEG_END = 0xDA, 0xD9
_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")
"""In a scan, 0xff followed by a zero or a restart number is not a marker."""


class Size(NamedTuple):
    """Width and height of a picture [px]."""

    width: int
    height: int


def size_of(data: bytes) -> Size | None:
    """Size of a whole PNG, JPEG or WebP file; None for a torn file or another format. Data after the end is ignored."""
    if data.startswith(_PNG):
        return _png(data)
    if data.startswith(_JPEG):
        return _jpeg(data)
    return _webp(data) if data[:4] == b"RIFF" and data[8:12] == b"WEBP" else None


def _png(data: bytes) -> Size | None:
    at, size = len(_PNG), None
    while at + 12 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        if kind == b"IHDR":
            size = Size(int.from_bytes(data[at + 8 : at + 12]), int.from_bytes(data[at + 12 : at + 16]))
        at += 12 + length
        if kind == _PNG_END:
            return size if at <= len(data) else None
    return None


def _jpeg(data: bytes) -> Size | None:
    at, size, in_scan = 2, None, False
    while (found := _MARKER.search(data, at)) is not None and (in_scan or found.start() == at):
        marker, at = found.group(1)[0], found.end()
        if marker == _JPEG_END:
            return size if in_scan else None
        if marker in _JPEG_SIZES:
            size = Size(int.from_bytes(data[at + 5 : at + 7]), int.from_bytes(data[at + 3 : at + 5]))
        in_scan = in_scan or marker == _JPEG_SCAN
        at += int.from_bytes(data[at : at + 2])
    return None


def _webp(data: bytes) -> Size | None:
    kind, head = data[12:16], data[20:30]
    if len(head) < 10 or len(data) < 8 + int.from_bytes(data[4:8], "little"):
        return None
    if kind == b"VP8X":
        return Size(1 + int.from_bytes(head[4:7], "little"), 1 + int.from_bytes(head[7:10], "little"))
    if kind == b"VP8 ":
        sides = (int.from_bytes(head[start : start + 2], "little") & 0x3FFF for start in (6, 8))
        return Size(*sides)
    bits = int.from_bytes(head[1:5], "little")
    return Size(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)) if kind == b"VP8L" else None
