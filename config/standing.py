"""Boxes of a station that stand where objects are looked for. Below its top, a known box hides what lies there."""

from __future__ import annotations

from collections.abc import Iterator

from config.origins import Place
from config.scene import Box, SceneSettings


def boxes_in_region(scene: SceneSettings) -> Iterator[tuple[Place, str]]:
    """Yield the tray and the obstacles that cover half of the pick region, or its middle: where they are set, and why.

    A smaller box at its side is a fixture that objects lie beside.
    """
    boxes: list[tuple[Place, Box]] = [(("scene", "tray"), scene.tray)]
    boxes += [(("scene", "obstacles", number), box) for number, box in enumerate(scene.obstacles)]
    for place, box in boxes:
        share, is_middle = _covered(box, scene.pick_region_m)
        if share >= 0.5 or is_middle:
            covered = f"{share:.0%} of scene.pick_region_m{'' if share >= 0.5 else ', and its middle'}"
            yield place, f"the box {box.name!r} covers {covered}: nothing is found there"


def _covered(box: Box, region_m: tuple[float, float, float, float]) -> tuple[float, bool]:
    """Return the share of the region that a box covers, seen from above, and whether it covers the middle."""
    sides = ((region_m[0], region_m[1]), (region_m[2], region_m[3]))
    share, is_middle = 1.0, True
    for (low, high), middle, size in zip(sides, box.center_m, box.size_m, strict=False):
        share *= max(0.0, min(high, middle + size / 2) - max(low, middle - size / 2)) / (high - low)
        is_middle = is_middle and abs((low + high) / 2 - middle) < size / 2
    return share, is_middle
