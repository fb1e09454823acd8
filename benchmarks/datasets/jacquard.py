"""The Jacquard dataset: ``*_RGB.png``, ``*_mask.png``, ``*_perfect_depth.tiff``, ``*_grasps.txt``, a folder per object.

A label line is ``x;y;theta_deg;opening_px;jaw_px``; theta turns from u towards v, as our ``angle_rad``. (Read in this
way, both ends of 79 % of the closing axes lie beside the object; read the other way round, of 45 %.)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.datasets.sample import Sample, halves, read_color, read_depth, read_image, require_folder
from bus.errors import ConfigError
from bus.messages import Rectangle

_DEPTHS = ("perfect_depth", "stereo_depth")


def read_jacquard(root: Path, depth: str = "perfect_depth") -> Iterator[Sample]:
    """Every view below ``root``; ``depth``: ``perfect_depth`` or ``stereo_depth``. Raises: ConfigError."""
    require_folder(root)
    if depth not in _DEPTHS:
        raise ConfigError(f"Jacquard has no depth {depth!r}.", f"There are: {', '.join(_DEPTHS)}.")
    pictures = sorted(root.rglob("*_RGB.png"))
    images = Counter(picture.parent for picture in pictures)
    half_of = dict(zip(images, halves(list(images.values())), strict=True))
    for picture in pictures:
        stem = picture.name.removesuffix("_RGB.png")
        mask, deep = (picture.with_name(f"{stem}_{kind}") for kind in ("mask.png", f"{depth}.tiff"))
        yield Sample(
            name=stem,
            color=read_color(picture),
            depth_m=read_depth(deep) if deep.exists() else None,
            mask=_mask(mask),
            truths=read_labels(picture.with_name(f"{stem}_grasps.txt")),
            half=half_of[picture.parent],
        )


def read_labels(path: Path) -> tuple[Rectangle, ...]:
    """The rectangles of one label file; rows with a NaN are left out. Raises: ConfigError."""
    try:
        rows = [[float(word) for word in line.split(";")] for line in path.read_text().splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise ConfigError(f"Cannot read the labels {path} ({error}).") from error
    if any(len(row) != 5 for row in rows):
        raise ConfigError(f"{path} does not hold x;y;theta;opening;jaw a line.")
    return tuple(
        Rectangle(
            center_px=(x, y), angle_rad=float(np.deg2rad(theta_deg) % np.pi), width_px=opening_px, height_px=jaw_px
        )
        for x, y, theta_deg, opening_px, jaw_px in rows
        if np.isfinite((x, y, theta_deg, opening_px, jaw_px)).all()
    )


def _mask(path: Path) -> np.ndarray:
    image = read_image(path)
    return np.asarray(np.asarray(image if image.ndim == 2 else image[..., 0], dtype=int) > 0)
