"""Checks of what the station tells the verdict about its objects."""

from __future__ import annotations

from cell.doctor.finding import Finding, ok, skip
from config.schema import Station

UNWEIGHED = (
    "Two equal things that come along as one - nested, stacked or side by side - are not noticed: set verify.max_load_n"
    " to 1.5 times the weight of one [N]."
)
"""What a cell cannot tell while it does not know what one object weighs."""


def double_picks(station: Station) -> Finding:
    """Say whether the weight of one object is known; without it the camera cannot tell every double pick."""
    name, need = "double picks", station.verify
    if need.max_load_n is None or "load" not in need.several_by:
        return skip(name, UNWEIGHED)
    return ok(name, f"More than {need.max_load_n:g} N is more than one object.")
