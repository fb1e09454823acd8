"""Notes in a picture of now where the pick region is in it, for whoever looks for a thing to pick."""

from __future__ import annotations

import json
import struct
import zlib

import numpy as np

from bus.messages import Observation
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.lift import project

REGION = "pick region"
"""Keyword of the text chunk of a PNG file: the region's corners on the table, [[u, v], ...] in its pixels, as JSON."""
_BEHIND_THE_HEADER = 33
"""Signature and header of a PNG file, in bytes."""


def with_region(png: bytes, seen: Observation, station: Station) -> bytes:
    """Return a PNG file of the undistorted picture with its pick region noted; unchanged where that is behind it."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    corners = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    corners_base = np.column_stack([corners, np.full(4, station.scene.table.top_m)])
    corners_camera = apply(inverse(seen.view.base_from_color), corners_base)
    if corners_camera[:, 2].min() <= 0:
        return png
    pixels = np.rint(project(corners_camera, seen.frame.color_camera)).astype(int)
    return _noted(png, REGION, json.dumps(pixels.tolist()))


def _noted(png: bytes, keyword: str, text: str) -> bytes:
    """The file with a text, which what shows pictures leaves aside."""
    chunk = b"tEXt" + keyword.encode("latin-1") + b"\0" + text.encode("latin-1")
    chunk = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return png[:_BEHIND_THE_HEADER] + chunk + png[_BEHIND_THE_HEADER:]
