"""Statistics of a feature as LeRobot keeps them, of an episode and of all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.export.clock import Array

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
KEYS = ("min", "max", "mean", "std", "count", *QUANTILES)
_STRIDE = 8

Stats = dict[str, Array]
"""The `KEYS` of one feature; all (d,), of pictures (channels, 1, 1), ``count`` (1,)."""


def of_numbers(values: Array) -> Stats:
    """Of one row a frame: (n, d) or (n,)."""
    rows = values.reshape(len(values), -1).astype(np.float64)
    found = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0)
    return {**found, "count": np.array([len(rows)]), **dict(zip(QUANTILES, quantiles, strict=True))}


def of_picture(picture: Array, frames: int) -> Stats:
    """Of one picture (H, W) or (H, W, channels) that so many frames show; of every eighth pixel each way."""
    few = picture[::_STRIDE, ::_STRIDE]
    stats = of_numbers(few.reshape(few.shape[0] * few.shape[1], -1))
    stats = {key: value[:, None, None] for key, value in stats.items() if key != "count"}
    return {**stats, "count": np.array([frames])}


def pooled(several: Sequence[Stats]) -> Stats:
    """Of all frames behind several statistics. Quantiles are weighted means of quantiles, as LeRobot pools them."""
    counts = np.array([int(stats["count"][0]) for stats in several])
    stacked = {key: np.stack([stats[key] for stats in several]) for key in KEYS if key != "count"}
    shares = (counts / counts.sum()).reshape(-1, *[1] * (stacked["mean"].ndim - 1))
    mean = (shares * stacked["mean"]).sum(0)
    variance = (shares * (stacked["std"] ** 2 + (stacked["mean"] - mean) ** 2)).sum(0)
    quantiles = {key: (shares * stacked[key]).sum(0) for key in QUANTILES}
    found = {"min": stacked["min"].min(0), "max": stacked["max"].max(0), "mean": mean, "std": np.sqrt(variance)}
    return {**found, "count": np.array([counts.sum()]), **quantiles}
