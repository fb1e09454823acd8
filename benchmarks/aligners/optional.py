"""The common part of aligners of other packages: whether one is here; clouds of equal size, which it aligns rigidly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from bus.errors import ConfigError
from bus.transforms import affine
from perception.align.base import Array, Fit, Shape, rms_radius_m

Solve = Callable[[Array, Array], tuple[Array, Array]]
"""Rotation (3, 3) and translation (3,) that map one cloud (n, 3) onto another (m, 3)."""


@dataclass(frozen=True)
class Package:
    """A package that no cell needs.

    Attributes:
        module: what is imported. ``name``: as its authors write it. ``advice``: how it can be had.
    """

    module: str
    name: str
    advice: str

    @property
    def is_here(self) -> bool:
        """True when it can be imported."""
        return find_spec(self.module) is not None

    def load(self, method: str) -> Any:
        """Import it for ``method``. Raises: ConfigError when it is not installed."""
        if not self.is_here:
            raise ConfigError(f"The alignment {method!r} needs {self.name}.", self.advice)
        return import_module(self.module)


def equal_sizes(goal: Shape, observed: Shape, solve: Solve) -> Fit:
    """Align rigidly with ``solve``: both clouds are centred and in units of their own rms radius.

    The scale is the ratio of these radii. Raises: as ``solve``.
    """
    goal_center, observed_center = goal.points.mean(axis=0), observed.points.mean(axis=0)
    goal_m, observed_m = rms_radius_m(goal.points), rms_radius_m(observed.points)
    rotation, shift = solve((goal.points - goal_center) / goal_m, (observed.points - observed_center) / observed_m)
    scale = observed_m / goal_m
    matrix = scale * rotation
    return Fit(affine(matrix, observed_center + observed_m * shift - matrix @ goal_center), scale, 1)
