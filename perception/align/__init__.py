"""Stage 2 of the paper: carry the imagined object, and so the rod, back onto the observed one."""

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
"""Those of a cell, by their names in a station file (`config.schema.PerceptionSettings.align`)."""


def align(
    method: str,
    goal: Shape,
    observed: Shape,
    *,
    max_residual: float = float("inf"),
    methods: Mapping[str, Callable[[Shape, Shape], Fit]] = METHODS,
) -> Alignment:
    """The map that carries ``goal`` onto ``observed``, found by ``method``, one of ``methods``.

    Raises: CycleFailure(MODEL_DRIFT) when a shape is too small, or what is left over exceeds ``max_residual``.
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
