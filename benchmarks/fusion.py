"""Three views of each scene, the camera mounted as believed or not: fused error before and after one common correction.

The same pictures serve every mounting and every table: only what the station believes of the camera's pose changes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.fused.scenes import KINDS, Seen, middle_of, see
from benchmarks.fused.truth import distances_m
from bus.transforms import angle_between_rad, from_rotation, from_translation, inverse
from drivers.sim.optics import COLOR_FROM_DEPTH, DEPTH
from perception.fusion.mounting import common_correction
from perception.fusion.table_or_mount import table_or_mount
from perception.geometry.depth import moved, rays, without_flying_pixels
from perception.geometry.voxels import averaged
from perception.scene.depth_view import DepthView
from perception.scene.normals import surface
from perception.scene.region import within
from perception.scene.table import find_table

MOUNTINGS = ((0.0, 0.0), (1.0, 0.3), (3.0, 0.5))
"""How far the camera is from where it is believed to be [mm, deg], in a direction of the seed."""
TILT_DEG = 2.0
_VOXEL_M = 0.003

Array = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Fused:
    """One scene at one mounting.

    Attributes:
        before_mm, after_mm: mean and 95th percentile of the distances of the fused points on objects from the truth.
        off_deg, left_deg: error of the mounting's rotation before and after. ``left_mm``: of its position, after.
        residual_mm: median distance between the views before and after.
        correction_ms, fusing_ms: CPU time: normals and correction; moving and averaging.
        named: what `table_or_mount` names.
    """

    kind: str
    before_mm: tuple[float, float]
    after_mm: tuple[float, float]
    off_deg: float
    left_deg: float
    left_mm: float
    residual_mm: tuple[float, float]
    correction_ms: float
    fusing_ms: float
    named: str


def run(
    development: Iterable[int], report: Iterable[int], objects: Path, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Return the report seeds' figures, and those of the development seeds beside them."""
    shown: dict[str, Any] = {}
    for name, seeds in (("report", list(report)), ("development", list(development))):
        rows: dict[tuple[float, float], list[Fused]] = {mounting: [] for mounting in MOUNTINGS}
        tilted: list[str] = []
        for seed in seeds:
            seen = see(seed, objects)
            for mm, deg in MOUNTINGS:
                rows[mm, deg].append(one := _measured(seen, _astray(seed, mm, deg)))
                tell(f"{name} {seed} {seen.kind} {mm} mm {deg} deg: {one.before_mm[0]:.2f} -> {one.after_mm[0]:.2f} mm")
            tilted.append(_named(seen, _leaning(seen, seed)))
        figures = _figures(rows, tilted) if seeds else {}
        shown |= figures if name == "report" else {name: figures}
    return shown


def _measured(seen: Seen, color_from_true: Array) -> Fused:
    """Fuse a scene as believed, and corrected; ``color_from_true`` (4, 4): what is wrong with the mounting."""
    believed = [pose @ inverse(color_from_true) for pose in seen.true_base_from_color]
    views = _views(seen, believed)
    began_s = time.process_time()
    surfaces, masks = [surface(view) for view in views], [within(view.points_base, seen.station) for view in views]
    found = common_correction(views, surfaces, believed, masks)
    corrected_s = time.process_time()
    after = _fused(seen, [found.view(view, pose) for view, pose in zip(views, believed, strict=True)])
    fused_s = time.process_time()
    left = found.color_from_corrected
    return Fused(
        seen.kind,
        _error_mm(_fused(seen, views), seen),
        _error_mm(after, seen),
        np.degrees(angle_between_rad(np.eye(4), color_from_true)),
        np.degrees(angle_between_rad(color_from_true, left)),
        1e3 * float(np.linalg.norm(color_from_true[:3, 3] - left[:3, 3])),
        (1e3 * found.residual_before_m, 1e3 * found.residual_after_m),
        1e3 * (corrected_s - began_s),
        1e3 * (fused_s - corrected_s),
        _named(seen, believed),
    )


def _views(seen: Seen, base_from_color: Sequence[Array]) -> list[DepthView]:
    views = []
    for measured_m, pose in zip(seen.depths_m, base_from_color, strict=True):
        depth_m, base_from_depth = without_flying_pixels(measured_m), pose @ COLOR_FROM_DEPTH
        points = moved(rays(DEPTH).astype(np.float32) * depth_m[..., None], base_from_depth)
        views.append(DepthView(depth_m, DEPTH, base_from_depth, points))
    return views


def _fused(seen: Seen, views: Sequence[DepthView]) -> Points:
    """The averaged points (n, 3) of the pick region; their colours are themselves, which takes as long."""
    points = np.concatenate([view.points_base[within(view.points_base, seen.station)] for view in views])
    return averaged(points, points, _VOXEL_M)[0]


def _error_mm(points_base: Points, seen: Seen) -> tuple[float, float]:
    errors_mm = 1e3 * distances_m(points_base, seen.parts)
    return float(errors_mm.mean()), float(np.percentile(errors_mm, 95))


def _named(seen: Seen, believed: Sequence[Array]) -> str:
    """Return what is named as wrong, from the planes that each view shows alone."""
    tables = [find_table(view.points_base, seen.station) for view in _views(seen, believed)]
    return table_or_mount(tables, believed, middle_of(seen.station)).named


def _astray(seed: int, mm: float, deg: float) -> Array:
    """A pose (4, 4) so far from the identity."""
    shift, axis = np.random.default_rng([seed, 11]).normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(deg) * axis / np.linalg.norm(axis))
    return from_rotation(turn.as_matrix(), mm / 1e3 * shift / np.linalg.norm(shift))


def _leaning(seen: Seen, seed: int) -> list[Array]:
    """The poses (4, 4) of the views in a ``base`` in which the table leans about a level axis through the middle."""
    around = np.random.default_rng([seed, 12]).uniform(0, 2 * np.pi)
    turn = Rotation.from_rotvec(np.deg2rad(TILT_DEG) * np.array([np.cos(around), np.sin(around), 0.0]))
    middle = middle_of(seen.station)
    motion = from_rotation(turn.as_matrix(), middle) @ from_translation(-middle)
    return [motion @ pose for pose in seen.true_base_from_color]


def _figures(rows: dict[tuple[float, float], list[Fused]], tilted: list[str]) -> dict[str, Any]:
    every = [one for several in rows.values() for one in several]
    return {
        "scenes": len(tilted),
        "mountings": [{"off_mm": mm, "off_deg": deg} | _of_mounting(several) for (mm, deg), several in rows.items()],
        "named_table_when_tilted": _share(tilted, "table"),
        "cpu_ms_median": {
            "correction": round(float(np.median([one.correction_ms for one in every])), 1),
            "fusing": round(float(np.median([one.fusing_ms for one in every])), 1),
            "both_p95": round(float(np.percentile([one.correction_ms + one.fusing_ms for one in every], 95)), 1),
        },
    }


def _of_mounting(rows: Sequence[Fused]) -> dict[str, Any]:
    """Means over the scenes."""
    named = [one.named for one in rows]
    return {
        "error_mm_before": _mean([one.before_mm for one in rows]),
        "error_mm_after": _mean([one.after_mm for one in rows]),
        "error_mm_after_of": {
            kind: _mean([one.after_mm for one in rows if one.kind == kind])
            for kind in KINDS
            if any(one.kind == kind for one in rows)
        },
        "rotation_deg_before": _mean([(one.off_deg,) for one in rows])[0],
        "rotation_deg_after": _mean([(one.left_deg,) for one in rows])[0],
        "position_mm_after": _mean([(one.left_mm,) for one in rows])[0],
        "residual_mm": _mean([one.residual_mm for one in rows]),
        "named_mount": _share(named, "mount"),
        "named_table": _share(named, "table"),
    }


def _mean(rows: Sequence[tuple[float, ...]]) -> list[float]:
    return [round(float(value), 3) for value in np.mean(rows, axis=0)]


def _share(named: Sequence[str], name: str) -> float:
    return round(sum(one == name for one in named) / len(named), 3)
