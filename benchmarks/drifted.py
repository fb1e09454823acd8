"""Seeded trials for alignment: an object on a table as a camera sees it, and as a drifting model imagines it.

The imagined image is rendered anew, so its visible surface changes; then its depth is distorted as monocular depth is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.scenes import CAMERA, Picture, Scene, render, scenes
from bus.transforms import affine, apply
from perception.align.base import Array, Shape
from perception.geometry.lift import lift_pixels, project

_DEPTH_NOISE = 0.002
_BLUR_PX = (1.0, 2.5)
_WAVELENGTH_PX = (300.0, 800.0)


@dataclass(frozen=True)
class Regime:
    """The drift of the imagined object: ranges, or the largest magnitude."""

    in_plane_deg: float
    out_of_plane_deg: float
    scale: tuple[float, float]
    relief: tuple[float, float]
    warp: tuple[float, float]
    stretch: float
    zoom: tuple[float, float]


REGIMES = {
    "hard": Regime(180.0, 25.0, (0.6, 1.6), (0.75, 1.3), (0.02, 0.06), 0.10, (0.85, 1.2)),
    "mild": Regime(15.0, 8.0, (0.8, 1.25), (0.85, 1.15), (0.01, 0.03), 0.05, (0.85, 1.2)),
}


@dataclass(frozen=True)
class Trial:
    """One pair of shapes and the truth; everything in the camera frame [m].

    Attributes:
        rod_goal_ends: (2, 3) the rod's axis where the spoilt depth puts it; rod_ends: (2, 3) where it truly is.
        symmetries: (k, 3, 3) rotations about ``center_m`` (3,) that leave the observed object as it is.
    """

    name: str
    goal: Shape
    observed: Shape
    rod_goal_ends: Array
    rod_ends: Array
    symmetries: Array
    center_m: Array
    diagonal_m: float


def trials(regime: str, count: int, seed: int) -> Iterator[Trial]:
    """``count`` trials, object after object; regimes share their scenes. Raises: KeyError for an unknown regime."""
    for scene, rng in scenes(count, seed):
        yield _trial(scene, REGIMES[regime], rng)


def _trial(scene: Scene, regime: Regime, rng: np.random.Generator) -> Trial:
    camera_from_object = scene.camera_from_object
    center = camera_from_object[:3, 3]
    goal, goal_ends = _imagine(scene, regime, rng)
    seen = render(scene, camera_from_object, None)
    noisy = seen.depth_m * (1 + _DEPTH_NOISE * rng.standard_normal(seen.depth_m.shape))
    observed = Shape(seen.object, np.zeros_like(seen.object), noisy.astype(np.float32), CAMERA)
    turn = camera_from_object[:3, :3]
    return Trial(
        name=scene.object.name,
        goal=goal,
        observed=observed,
        rod_goal_ends=goal_ends,
        rod_ends=apply(camera_from_object, scene.rod_ends),
        symmetries=turn @ scene.object.symmetries @ turn.T,
        center_m=center,
        diagonal_m=float(2 * np.linalg.norm(scene.object.half_m)),
    )


# --- the drift --------------------------------------------------------------------------------------------------------


def _imagine(scene: Scene, regime: Regime, rng: np.random.Generator) -> tuple[Shape, Array]:
    """The goal image's shape, and the rod's ends as its depth has them."""
    camera_from_object = _drifted(scene.camera_from_object, regime, rng)
    ends = apply(camera_from_object, scene.rod_ends)
    picture = render(scene, camera_from_object, ends)
    middle_m = float(np.median(picture.depth_m[picture.object]))
    scale, relief = np.exp(rng.uniform(*np.log(regime.scale))), rng.uniform(*regime.relief)
    bend, wave, phase = rng.uniform(*regime.warp), _waves(rng), rng.uniform(0, 2 * np.pi, 2)

    def spoil(z_m: Array, u: Array, v: Array) -> Array:
        warp = 1 + bend * np.sin(np.multiply.outer(u, wave[0]) + np.multiply.outer(v, wave[1]) + phase).mean(axis=-1)
        return np.asarray(scale * (middle_m + relief * (z_m - middle_m)) * warp)

    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    known = np.isfinite(picture.depth_m)
    depth = np.full(known.shape, np.nan)
    depth[known] = spoil(picture.depth_m[known], u[known], v[known])
    pixels = project(ends, CAMERA)
    goal_ends = lift_pixels(pixels, spoil(ends[:, 2], pixels[:, 0], pixels[:, 1]), CAMERA)
    return _bled(depth, picture, rng), goal_ends


def _drifted(camera_from_object: Array, regime: Regime, rng: np.random.Generator) -> Array:
    """Turned about the object's centre, stretched along its own axes, and brought nearer by the zoom."""
    turn = Rotation.from_euler("z", rng.uniform(-regime.in_plane_deg, regime.in_plane_deg), degrees=True)
    axis = rng.uniform(0, 2 * np.pi)
    tip = np.radians(rng.uniform(0, regime.out_of_plane_deg)) * np.array([np.cos(axis), np.sin(axis), 0.0])
    drift = (turn * Rotation.from_rotvec(tip)).as_matrix()
    stretch = np.diag(np.exp(rng.uniform(-regime.stretch, regime.stretch, 3)))
    return affine(drift @ camera_from_object[:3, :3] @ stretch, camera_from_object[:3, 3] / rng.uniform(*regime.zoom))


def _waves(rng: np.random.Generator) -> Array:
    """(2, 2) rows u, v: two plane waves [rad/px], long against an object."""
    heading, length_px = rng.uniform(0, 2 * np.pi, 2), rng.uniform(*_WAVELENGTH_PX, 2)
    return np.asarray(np.stack([np.cos(heading), np.sin(heading)]) * 2 * np.pi / length_px)


def _bled(depth: Array, picture: Picture, rng: np.random.Generator) -> Shape:
    """Depth that bleeds over the silhouette, noise, and a mask that is one pixel too small, right or too large."""
    rows, columns = np.nonzero(np.isfinite(depth))
    window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    sigma_px = rng.uniform(*_BLUR_PX)
    blurred = cv2.GaussianBlur(depth[window], (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    depth[window] = blurred * (1 + _DEPTH_NOISE * rng.standard_normal(blurred.shape))
    grown_px = int(rng.integers(-1, 2))
    change, kernel = cv2.MORPH_DILATE if grown_px > 0 else cv2.MORPH_ERODE, np.ones((1 + 2 * abs(grown_px),) * 2)
    mask = cv2.morphologyEx(picture.object.astype(np.uint8), change, kernel).astype(bool)
    return Shape(mask & ~picture.rod & np.isfinite(depth), picture.rod, depth.astype(np.float32), CAMERA)
