"""Alignment methods that a cell is compared with and does not offer, and those it does: on one interface."""

from __future__ import annotations

from benchmarks.aligners import kiss, teaser
from benchmarks.aligners.icp import icp
from benchmarks.aligners.optional import Package
from benchmarks.aligners.pca_printed import pca_cfopt_printed
from perception.align import METHODS

ALL = {
    **METHODS,
    "pca_cfopt_printed": pca_cfopt_printed,
    "icp": icp,
    "kiss_matcher": kiss.kiss_matcher,
    "teaser": teaser.teaser,
}
"""By name, as `perception.align.align` takes them."""
OPTIONAL: dict[str, Package] = {"kiss_matcher": kiss.PACKAGE, "teaser": teaser.PACKAGE}
"""The package that a method needs, by the method's name."""
ALIGNERS = tuple(name for name in ALL if name not in OPTIONAL or OPTIONAL[name].is_here)
"""The names of those that can be used here."""
