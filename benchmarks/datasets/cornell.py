"""The Cornell grasp dataset: ``pcdNNNNr.png``, ``pcdNNNNd.tiff`` and ``pcdNNNNcpos.txt``.

A label is four corner lines ``x y`` [px]; the edge from the first to the second corner is the closing axis. The depth
is a hole-filled distance in a frame other than the camera's: usable as an input channel, not for 3-D.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.datasets.sample import Sample, read_color, read_depth, require_folder
from bus.errors import ConfigError
from bus.messages import Rectangle


def read_cornell(root: Path) -> Iterator[Sample]:
    """Every labelled image below ``root/rgbd`` and ``root/rgb``, by number. Raises: ConfigError."""
    require_folder(root, "rgb", "rgbd")
    for picture in sorted([*root.glob("rgbd/pcd*r.png"), *root.glob("rgb/pcd*r.png")], key=lambda path: path.name):
        stem = picture.name.removesuffix("r.png")
        depth = picture.with_name(f"{stem}d.tiff")
        yield Sample(
            name=stem,
            color=read_color(picture),
            depth_m=read_depth(depth) if depth.exists() else None,
            mask=None,
            truths=read_labels(picture.with_name(f"{stem}cpos.txt")),
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
