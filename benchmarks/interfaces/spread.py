"""The spread of many short times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def spread_ms(took_s: Sequence[float]) -> dict[str, Any]:
    """Return the median, the 99th percentile and the longest of times [s], in ms, and their number."""
    took_ms = np.asarray(took_s) * 1e3
    return {
        "p50": round(float(np.median(took_ms)), 2),
        "p99": round(float(np.quantile(took_ms, 0.99)), 2),
        "max": round(float(took_ms.max()), 2),
        "n": len(took_s),
    }
