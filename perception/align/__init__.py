"""Stage 2 of the paper: align the imagined object to the observed one, and with it the rod.

All clouds and maps are in the ``color`` frame, in metres; see docs/frames.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Alignment
from perception.align.base import Fit, Shape, residuals
from perception.align.pca import pca_cfopt
from perception.align.silhouette_3d import silhouette_3d

METHODS: Mapping[str, Callable[[Shape, Shape], Fit]] = {
    "silhouette_3d": silhouette_3d,
    "pca_cfopt": pca_cfopt,
}
"""The methods of a cell, by their names in a station file."""


def align(
    method: str,
    goal: Shape,
    observed: Shape,
    *,
    max_residual: float = float("inf"),
    methods: Mapping[str, Callable[[Shape, Shape], Fit]] = METHODS,
) -> Alignment:
    """Align ``goal`` to ``observed`` with ``method``, and measure the fit.

    Args:
        method: one of ``methods`` (those of a station: `config.schema.PerceptionSettings.align`).
        max_residual: the largest accepted `Residuals.residual`, as a share of the observed object's rms radius.

    Raises:
        CycleFailure: MODEL_DRIFT when a shape has too few points, or the residual exceeds ``max_residual``.
    """
    began_s = time.perf_counter()
    fit = methods[method](goal, observed)
    judged = residuals(goal.points, observed.points, fit.observed_from_goal)
    if judged.residual > max_residual:
        raise CycleFailure(
            Code.MODEL_DRIFT,
            f"The imagined object does not fit the observed one: residual {judged.residual:.2f}, at most "
            f"{max_residual:.2f} of its radius.",
        )
    return Alignment(method=method, **fit._asdict(), **judged._asdict(), took_s=time.perf_counter() - began_s)
