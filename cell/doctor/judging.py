"""Checks of what a person has told the station: its values, and what the verdict knows about its objects."""

from __future__ import annotations

from pathlib import Path

from cell.doctor.finding import Finding, fix, ok, skip
from config.schema import Station
from config.undecided import undecided

UNWEIGHED = (
    "Two equal things that come along as one - nested, stacked or side by side - are not noticed: set verify.max_load_n"
    " to 1.5 times the weight of one [N]."
)
"""The limit of a cell that does not know what one object weighs."""


def double_picks(station: Station) -> Finding:
    """Say whether the weight of one object is known; without it the camera cannot tell every double pick."""
    name, need = "double picks", station.verify
    if need.max_load_n is None or "load" not in need.several_by:
        return skip(name, UNWEIGHED)
    return ok(name, f"More than {need.max_load_n:g} N is more than one object.")


def values(station: Station, file: Path) -> Finding:
    """Say which lines of the station's file are still marked CHANGE or DECIDE; a simulated cell runs with any."""
    left = undecided(file)
    if left is None:
        return ok("values", f"No line of {file} is marked CHANGE or DECIDE.")
    return skip("values", f"{left[0]}. {left[1]}") if station.simulated else fix("values", f"{left[0]}.", left[1])
