"""Alignment methods that a cell is compared with and does not offer, and those it does: on one interface."""

from __future__ import annotations

from importlib.util import find_spec

from benchmarks.aligners.icp import icp
from benchmarks.aligners.pca_printed import pca_cfopt_printed
from benchmarks.aligners.teaser import PACKAGE, teaser
from perception.align import METHODS

ALL = {**METHODS, "pca_cfopt_printed": pca_cfopt_printed, "icp": icp, "teaser": teaser}
"""By name, as `perception.align.align` takes them."""
ALIGNERS = tuple(name for name in ALL if name != "teaser" or find_spec(PACKAGE) is not None)
"""The names of those that can be used here."""
