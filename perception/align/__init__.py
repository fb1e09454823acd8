"""Stage 2 of the paper: align the imagined object to the observed one, and with it the rod.

All clouds and maps are in the ``color`` frame, in metres; see docs/frames.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Alignment
from perception.align.base import Fit, Shape, residuals
from perception.align.icp import icp
from perception.align.pca import pca_cfopt, pca_cfopt_printed
from perception.align.silhouette_3d import silhouette_3d
from perception.align.teaser import PACKAGE, teaser

_METHODS: dict[str, Callable[[Shape, Shape], Fit]] = {
    "silhouette_3d": silhouette_3d,
    "pca_cfopt": pca_cfopt,
    "pca_cfopt_printed": pca_cfopt_printed,
    "icp": icp,
    "teaser": teaser,
}


def align(method: str, goal: Shape, observed: Shape, *, max_residual: float = float("inf")) -> Alignment:
    """Align ``goal`` to ``observed`` with ``method``, and measure the fit.

    Args:
        method: one of `ALIGNERS` (`config.schema.PerceptionSettings.align`).
        max_residual: the largest accepted `Residuals.residual`, as a share of the observed object's rms radius.

    Raises:
        CycleFailure: MODEL_DRIFT when a shape has too few points, or the residual exceeds ``max_residual``.
        ConfigError: TEASER++ is asked for and is not installed.
    """
    began_s = time.perf_counter()
    fit = _METHODS[method](goal, observed)
    judged = residuals(goal.points, observed.points, fit.observed_from_goal)
    if judged.residual > max_residual:
        raise CycleFailure(
            Code.MODEL_DRIFT,
            f"The imagined object does not fit the observed one: residual {judged.residual:.2f}, at most "
            f"{max_residual:.2f} of its radius.",
        )
    return Alignment(method=method, **fit._asdict(), **judged._asdict(), took_s=time.perf_counter() - began_s)


ALIGNERS = tuple(name for name in _METHODS if name != "teaser" or find_spec(PACKAGE) is not None)
"""The methods whose packages are installed here."""
