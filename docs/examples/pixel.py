"""Finds a pixel of a coloured thing in a picture of the cell, with the standard library only.

Usage: python pixel.py PICTURE.png COLOUR, e.g. red; prints the target of a job, {"pixel": [u, v]}. The picture says
where the pick region is in it: what lies elsewhere, as in the tray, is no target.
"""

import colorsys
import json
import struct
import sys
import zlib
from pathlib import Path

HUES_DEG = {"red": 0, "orange": 30, "yellow": 60, "green": 120, "cyan": 180, "blue": 230, "purple": 280, "pink": 330}
STEP_PX = 4  # every fourth pixel of every fourth row is enough
Pixel = tuple[int, int]


def decoded(png: bytes) -> tuple[int, list[bytearray], list[Pixel]]:
    """Width [px], rows, three bytes (R, G, B) a pixel, and the pick region's corners, of a PNG of 8 bits a channel."""
    width, _, depth, kind, _, _, interlaced = struct.unpack(">IIBBBBB", png[16:29])
    if (depth, kind, interlaced) != (8, 2, 0):
        raise ValueError("not the picture of a cell")
    packed, corners, at = b"", [], 8
    while at < len(png):
        size, name = struct.unpack(">I4s", png[at : at + 8])
        chunk = png[at + 8 : at + 8 + size]
        if name == b"IDAT":
            packed += chunk
        elif name == b"tEXt" and chunk.startswith(b"pick region\0"):
            corners = json.loads(chunk.partition(b"\0")[2])
        at += 12 + size
    raw, length = zlib.decompress(packed), 3 * width
    rows, above = [], bytearray(length)
    for start in range(0, len(raw), length + 1):
        above = unfiltered(raw[start], bytearray(raw[start + 1 : start + 1 + length]), above)
        rows.append(above)
    return width, rows, corners


def unfiltered(kind: int, row: bytearray, above: bytearray) -> bytearray:
    """A row without its PNG filter: 0 none, 1 left, 2 above, 3 mean of both, 4 Paeth."""
    for i in range(len(row)) if kind else ():
        left, corner = (row[i - 3], above[i - 3]) if i >= 3 else (0, 0)
        if kind == 4:
            guess = left + above[i] - corner
            add = min((left, above[i], corner), key=lambda near: abs(guess - near))
        else:
            add = (0, left, above[i], (left + above[i]) // 2)[kind]
        row[i] = (row[i] + add) & 255
    return row


def pixel_of(png: bytes, color: str) -> Pixel:
    """The pixel (u, v) nearest to the middle of the largest area of that colour in the pick region.

    Raises: ValueError without one.
    """
    if color not in HUES_DEG:
        raise ValueError(f"a colour is one of {', '.join(HUES_DEG)}")
    width, rows, corners = decoded(png)
    alike = {
        (u, v)
        for v in range(0, len(rows), STEP_PX)
        for u in range(0, width, STEP_PX)
        if is_of(HUES_DEG[color], *rows[v][3 * u : 3 * u + 3]) and is_inside(u, v, corners)
    }
    largest: list[Pixel] = []
    while alike:
        area = [alike.pop()]
        for u, v in area:  # it grows meanwhile
            for near in ((u - STEP_PX, v), (u + STEP_PX, v), (u, v - STEP_PX), (u, v + STEP_PX)):
                if near in alike:
                    alike.remove(near)
                    area.append(near)
        largest = max(largest, area, key=len)
    if not largest:
        raise ValueError(f"nothing {color} is in the pick region of the picture")
    middle = [sum(one[axis] for one in largest) / len(largest) for axis in (0, 1)]
    return min(largest, key=lambda one: (one[0] - middle[0]) ** 2 + (one[1] - middle[1]) ** 2)


def is_of(hue_deg: int, red: int, green: int, blue: int) -> bool:
    hue, saturation, value = colorsys.rgb_to_hsv(red / 255, green / 255, blue / 255)
    return saturation > 0.4 and value > 0.2 and abs((360 * hue - hue_deg + 180) % 360 - 180) < 15


def is_inside(u: int, v: int, corners: list[Pixel]) -> bool:
    """Whether a pixel is on the same side of every edge; without any corners it is."""
    edges = zip(corners, corners[1:] + corners[:1], strict=True)
    sides = [(u1 - u0) * (v - v0) - (v1 - v0) * (u - u0) for (u0, v0), (u1, v1) in edges]
    return all(side >= 0 for side in sides) or all(side <= 0 for side in sides)


if __name__ == "__main__":
    try:
        print(json.dumps({"pixel": pixel_of(Path(sys.argv[1]).read_bytes(), sys.argv[2])}))
    except ValueError as error:
        sys.exit(str(error))
