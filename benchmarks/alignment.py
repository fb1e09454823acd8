"""Accuracy of each alignment method for the rod, the distance of its clouds, and its cost [ms of CPU]."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import nan
from pathlib import Path
from statistics import fmean, median
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from benchmarks import drifted
from benchmarks.aligners import ALIGNERS, ALL, OPTIONAL
from benchmarks.drifted import Trial
from benchmarks.sheet import write_sheet
from bus.errors import CycleFailure
from bus.messages import Alignment
from bus.transforms import apply
from perception.align import align
from perception.align.base import Array, Shape, nearest
from perception.geometry.lift import project

_MAX_ANGLE_DEG, _MAX_OFF = 15.0, 0.10
_TILE_PX, _MARGIN_PX = 220, 12
_COLUMNS = 4

PAPER_TABLE_III = {
    "teaser": {"success": 0.5571, "cd_m2": 0.24e-3, "uhd_m": 5.68e-2},
    "icp": {"success": 0.3429, "cd_m2": 76.8e-3, "uhd_m": 50.8e-2},
    "pca_cfopt": {"success": 0.9143, "cd_m2": 0.17e-3, "uhd_m": 7.21e-2},
}
"""As printed, of other images and other objects."""


@dataclass(frozen=True)
class Score:
    """One method on one trial: successes against the one true rod, and against the best symmetric one."""

    raw3d: bool
    sym3d: bool
    raw_img: bool
    sym_img: bool
    cd_m2: float
    uhd_m: float
    hausdorff_m: float


def run(regime: str, trials: int, seed: int, *, tell: Callable[[str], None] = lambda line: None) -> dict[str, Any]:
    """Every method on the same ``trials``; ``regime``: hard or mild. ``tell`` hears a line per trial, then the table.

    ``success`` counts the rod's best symmetric place, ``success_strict`` its one true place, both in the image, as the
    paper measures; ``raw3d`` and ``sym3d`` are the same in space.
    """
    cv2.setNumThreads(1)
    methods = {name: partial(align, name, methods=ALL) for name in ALIGNERS}
    scores: dict[str, list[Score | None]] = {name: [] for name in methods}
    took_ms: dict[str, list[float]] = {name: [] for name in methods}
    for number, trial in enumerate(drifted.trials(regime, trials, seed), 1):
        for name, method in methods.items():
            alignment, ms = _timed(method, trial)
            scores[name].append(None if alignment is None else score(trial, alignment.observed_from_goal))
            took_ms[name].append(ms)
        tell(f"{number}/{trials} {trial.name}")
    figures = {name: _figures(scores[name], took_ms[name]) for name in methods}
    without = {name: f"not installed: {OPTIONAL[name].advice}" for name in OPTIONAL if name not in methods}
    for line in (*table(figures), *(f"{name} is {why}" for name, why in without.items())):
        tell(line)
    run = {"regime": regime, "trials": trials, "seed": seed, **figures, "left_out": without}
    return {**run, "paper_table_iii": PAPER_TABLE_III}


def table(figures: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """The figures of all methods as Markdown; lengths in cm, nan where every trial was refused."""
    yield "| method | success | strict | CD [m²] | UHD [cm] | two-way Hausdorff [cm] | ms | refused |"
    yield "|---|---|---|---|---|---|---|---|"
    for name, of in figures.items():
        shares = " | ".join(f"{of[share]:.1%}".replace("%", " %") for share in ("success", "success_strict"))
        cd_m2, uhd_m, hausdorff_m = (nan if of[mean] is None else of[mean] for mean in _MEANS)
        distances = f"{cd_m2 * 1e3:.3f}e-3 | {uhd_m * 1e2:.2f} | {hausdorff_m * 1e2:.2f}"
        yield f"| {name} | {shares} | {distances} | {of['ms']:.0f} | {of['refused']} |"


def score(trial: Trial, observed_from_goal: Array) -> Score:
    """Judge one map goal -> observed against the truth."""
    carried = apply(observed_from_goal, trial.rod_goal_ends)
    turned = (trial.rod_ends - trial.center_m) @ trial.symmetries.transpose(0, 2, 1) + trial.center_m
    diagonal_px = trial.diagonal_m * trial.observed.camera.fx / trial.center_m[2]
    carried_px = project(carried, trial.observed.camera)
    turned_px = project(turned.reshape(-1, 3), trial.observed.camera).reshape(-1, 2, 2)
    true_px = project(trial.rod_ends, trial.observed.camera)
    goal, observed = apply(observed_from_goal, trial.goal.points), trial.observed.points
    forth, back = nearest(goal, cKDTree(observed)), nearest(observed, cKDTree(goal))
    return Score(
        raw3d=bool(_hits(carried, trial.rod_ends[None], trial.diagonal_m)[0]),
        sym3d=bool(_hits(carried, turned, trial.diagonal_m).any()),
        raw_img=bool(_hits(carried_px, true_px[None], diagonal_px)[0]),
        sym_img=bool(_hits(carried_px, turned_px, diagonal_px).any()),
        cd_m2=float((forth**2).mean() + (back**2).mean()),
        uhd_m=float(forth.max()),
        hausdorff_m=float(max(forth.max(), back.max())),
    )


def contact_sheet(path: Path, count: int, seed: int, regime: str = "hard") -> None:
    """A PNG of pairs: what is observed with the true rod's axis, and what is imagined with the rod in it."""
    tiles = [
        np.hstack([_tile(trial.observed, trial.name, trial.rod_ends), _tile(trial.goal, "goal", None)])
        for trial in drifted.trials(regime, count, seed)
    ]
    write_sheet(path, tiles, _COLUMNS)


def _timed(method: Callable[[Shape, Shape], Alignment], trial: Trial) -> tuple[Alignment | None, float]:
    """The method on fresh shapes, so that nothing another method worked out is reused; None when it refuses."""
    goal, observed = replace(trial.goal), replace(trial.observed)
    began_s = time.process_time()
    try:
        alignment = method(goal, observed)
    except CycleFailure:
        alignment = None
    return alignment, (time.process_time() - began_s) * 1e3


def _figures(scores: Sequence[Score | None], took_ms: Sequence[float]) -> dict[str, float | int | None]:
    """Shares of all trials, means over those that were not refused, the median time."""
    kept = [one for one in scores if one is not None]
    shares = {name: sum(getattr(one, name) for one in kept) / max(len(scores), 1) for name in _SHARES}
    means = {name: fmean(getattr(one, name) for one in kept) if kept else None for name in _MEANS}
    success = {"success": shares["sym_img"], "success_strict": shares["raw_img"]}
    took = {"ms": median(took_ms) if took_ms else None, "refused": len(scores) - len(kept)}
    return {**success, **shares, **means, **took}


_SHARES = ("raw3d", "sym3d", "raw_img", "sym_img")
_MEANS = ("cd_m2", "uhd_m", "hausdorff_m")


def _hits(carried: Array, truths: Array, diagonal: float) -> npt.NDArray[np.bool_]:
    """Return which true rods (k, 2, d) the carried one (2, d) matches, in axis modulo sign and in centre."""
    along, true_along = carried[1] - carried[0], truths[:, 1] - truths[:, 0]
    lengths = np.linalg.norm(along) * np.linalg.norm(true_along, axis=1)
    aligned = np.abs(true_along @ along) > np.cos(np.radians(_MAX_ANGLE_DEG)) * lengths
    off = np.linalg.norm(truths.mean(axis=1) - carried.mean(axis=0), axis=1)
    return np.asarray(aligned & (off < _MAX_OFF * diagonal))


def _tile(shape: Shape, text: str, rod_ends: Array | None) -> npt.NDArray[np.uint8]:
    """Depth lit from the upper left, the object's mask tinted, the rod in red."""
    gray = _lit(shape.depth_m, shape.camera.fx)
    image = np.stack([gray, gray, gray], axis=2)
    image[~shape.mask] *= 0.5
    image[shape.hidden] = image[shape.hidden] * 0.5 + np.array([0, 0, 0.5])
    if rod_ends is not None:
        ends = np.rint(project(rod_ends, shape.camera)).astype(int)
        cv2.line(image, ends[0].tolist(), ends[1].tolist(), (0, 0, 1), 1, cv2.LINE_AA)
    rows, columns = np.nonzero(np.isfinite(shape.depth_m))
    cut = image[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    shrink = (_TILE_PX - _MARGIN_PX) / max(cut.shape[:2])
    small = cv2.resize(cut, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    tile = np.zeros((_TILE_PX, _TILE_PX, 3), np.uint8)
    tile[: small.shape[0], : small.shape[1]] = np.clip(small * 255, 0, 255).astype(np.uint8)
    cv2.putText(tile, text, (4, _TILE_PX - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 255, 255), 1, cv2.LINE_AA)
    return tile


def _lit(depth_m: npt.NDArray[np.float32], focal_px: float) -> Array:
    """(H, W) 0..1."""
    smooth = cv2.GaussianBlur(np.nan_to_num(depth_m, nan=1.0), (0, 0), 1.2)
    down, right = np.array(np.gradient(smooth.astype(float))) * focal_px / np.maximum(smooth, 0.1)
    return np.asarray(np.clip((0.8 - 0.4 * right - 0.4 * down) / np.sqrt(1 + right**2 + down**2), 0.05, 1))
