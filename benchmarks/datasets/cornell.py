"""The Cornell grasp dataset: ``pcdNNNNr.png``, ``pcdNNNNd.tiff`` and ``pcdNNNNcpos.txt``.

A label is four corner lines ``x y`` [px]; the edge from the first to the second corner is the closing axis. The depth
is a hole-filled distance in a frame other than the camera's: usable as an input channel, not for 3-D.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.datasets.sample import Sample, halves, read_color, read_depth, require_folder
from bus.errors import ConfigError
from bus.messages import Rectangle

_FIRST_OF_OBJECT = (
    *(100, 106, 110, 114, 118, 122, 126, 201, 205, 209, 213, 217, 219, 236, 300, 308, 312, 316, 320, 324, 328, 331),
    *(
        336,
        339,
        600,
        602,
        606,
        610,
        614,
        620,
        622,
        625,
        628,
        860,
        864,
        868,
        873,
        876,
        880,
        884,
        886,
        890,
        892,
        894,
        898,
    ),
)
"""The number with which each object's pictures begin, among those of 0100-0129, 0200-0239, 0300-0339, 0600-0629 and
0860-0899: consecutive ones show one object."""


def read_cornell(root: Path) -> Iterator[Sample]:
    """Every labelled image below ``root/rgbd`` and ``root/rgb``, by number. Raises: ConfigError."""
    require_folder(root, "rgb", "rgbd")
    pictures = sorted([*root.glob("rgbd/pcd*r.png"), *root.glob("rgb/pcd*r.png")], key=lambda path: path.name)
    objects = [bisect_right(_FIRST_OF_OBJECT, int(picture.name[3:7])) for picture in pictures]
    images = Counter(objects)
    half_of = dict(zip(images, halves(list(images.values())), strict=True))
    for picture, shown in zip(pictures, objects, strict=True):
        stem = picture.name.removesuffix("r.png")
        depth = picture.with_name(f"{stem}d.tiff")
        yield Sample(
            name=stem,
            color=read_color(picture),
            depth_m=read_depth(depth) if depth.exists() else None,
            mask=None,
            truths=read_labels(picture.with_name(f"{stem}cpos.txt")),
            half=half_of[shown],
        )


def read_labels(path: Path) -> tuple[Rectangle, ...]:
    """The rectangles of one label file; those with a NaN corner are left out. Raises: ConfigError."""
    try:
        corners = np.array(
            [[float(word) for word in line.split()] for line in path.read_text().splitlines() if line.strip()]
        )
    except (OSError, ValueError) as error:
        raise ConfigError(f"Cannot read the labels {path} ({error}).") from error
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) % 4:
        raise ConfigError(f"{path} does not hold four corner lines a rectangle.")
    return tuple(_rectangle(four) for four in corners.reshape(-1, 4, 2) if np.isfinite(four).all())


def _rectangle(corners: np.ndarray) -> Rectangle:
    along, across = corners[1] - corners[0], corners[2] - corners[1]
    u, v = corners.mean(axis=0)
    return Rectangle(
        center_px=(float(u), float(v)),
        angle_rad=float(np.arctan2(along[1], along[0]) % np.pi),
        width_px=float(np.linalg.norm(along)),
        height_px=float(np.linalg.norm(across)),
    )
