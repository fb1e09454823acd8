"""Depth images of boxes, by ray casting."""

from __future__ import annotations

import numpy as np

from config.scene import Box

PIXEL_M = 0.004


def seen_from_above(
    boxes: tuple[Box, ...],
    *,
    eye_m: tuple[float, float, float],
    target: Box | None = None,
    noise_m: float = 0.0,
    holes_px: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Points (h, w, 3) in ``base`` that a camera at ``eye_m`` sees, and which of them are the target's.

    Args:
        holes_px: so many pixels at each depth edge have no depth.
    """
    x, y = np.meshgrid(np.arange(0.0, 0.9, PIXEL_M), np.arange(-0.6, 0.6, PIXEL_M))
    rays = np.stack([x, y, np.zeros_like(x)], axis=-1) - eye_m
    hits = np.stack([_entry(rays, np.array(eye_m), one) for one in (*boxes, *([target] if target else []))])
    owner, share = np.argmin(hits, axis=0), hits.min(axis=0)
    share = share + np.random.default_rng(1).normal(0.0, noise_m, share.shape) / np.linalg.norm(rays, axis=-1)
    points = np.asarray(eye_m) + share[..., None] * rays
    points[~np.isfinite(share)] = np.nan
    for _ in range(holes_px):
        points[_edges(points[..., 2])] = np.nan
    return points.astype(np.float32), (owner == len(boxes)) & np.isfinite(points[..., 2])


def _entry(rays: np.ndarray, eye_m: np.ndarray, box: Box) -> np.ndarray:
    low = np.array(box.center_m) - np.array(box.size_m) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (low - eye_m) / rays, (low + box.size_m - eye_m) / rays
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.where(enter <= leave, enter, np.inf)


def _edges(height_m: np.ndarray) -> np.ndarray:
    filled = np.where(np.isnan(height_m), -1.0, height_m)
    jump = np.zeros(filled.shape, dtype=bool)
    for axis in (0, 1):
        step = np.abs(np.diff(filled, axis=axis)) > 0.02
        first = [slice(None), slice(None)]
        first[axis] = slice(0, -1)
        jump[tuple(first)] |= step
    return jump
