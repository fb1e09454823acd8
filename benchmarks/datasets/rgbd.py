"""Real RGB-D frames without labels, a ``NAME.npz`` each: ``color`` (H, W, 3) RGB, ``depth_m`` (H, W) with NaN = none,
``K`` (fx, fy, cx, cy), ``base_from_color`` (4, 4), ``region`` (x_min, x_max, y_min, y_max) in ``base``.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.datasets.sample import require_folder
from bus.errors import ConfigError
from bus.messages import CameraModel, Frame, Observation, View


@dataclass(frozen=True)
class RealFrame:
    """One frame as the cell would capture it, and the pick region [m] it goes with."""

    name: str
    observation: Observation
    region_m: tuple[float, float, float, float]


def read_rgbd(root: Path) -> Iterator[RealFrame]:
    """Every frame in ``root``, by name. Raises: ConfigError for no folder, no frame, or one that is not whole."""
    require_folder(root)
    paths = sorted(root.glob("*.npz"))
    if not paths:
        raise ConfigError(f"There is no .npz in {root}.", "Name the dataset's folder with --root.")
    for path in paths:
        yield read_frame(path)


def read_frame(path: Path) -> RealFrame:
    """One frame. Raises: ConfigError when the file is not whole."""
    try:
        with np.load(path) as stored:
            color, depth_m = stored["color"], stored["depth_m"].astype(np.float32)
            fx, fy, cx, cy = (float(value) for value in stored["K"])
            x_min, x_max, y_min, y_max = (float(value) for value in stored["region"])
            base_from_color = stored["base_from_color"].astype(float)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path} is not a whole RGB-D frame ({error}).", f"It holds: {__doc__}") from error
    camera = CameraModel(width=color.shape[1], height=color.shape[0], fx=fx, fy=fy, cx=cx, cy=cy)
    frame = Frame(
        stamp_ns=1, color=color, depth_m=depth_m, color_camera=camera, depth_camera=camera, color_from_depth=np.eye(4)
    )
    view = View(stamp_ns=1, base_from_color=base_from_color)
    return RealFrame(path.stem, Observation(view=view, frame=frame), (x_min, x_max, y_min, y_max))
