"""The check of the catalogue of recorded cycles."""

from __future__ import annotations

from bus.errors import CellError
from cell.doctor.finding import Finding, fix, ok, skip
from config.schema import Station
from logs.catalogue.health import Health, health

_READ_PER_S = 80
"""Recordings that are read in a second, about: `benchmarks catalogue`."""


def catalogue(station: Station) -> Finding:
    """Check that the catalogue can be used and says what the recordings hold; nothing is changed."""
    name, folder = "catalogue", station.recording.folder.absolute()
    if not folder.is_dir():
        return skip(name, f"Nothing was recorded yet in {folder}.")
    try:
        found = health(folder)
    except CellError as error:
        return fix(name, error.text, error.advice)
    if found.trouble and not found.unread:
        return skip(name, f"There is nothing for it to list in {folder}.")
    if found.trouble:
        return fix(name, f"The catalogue in {folder} cannot be used, because {found.trouble}.", _rebuild(found))
    if found.unread or found.gone:
        told = f"{found.unread} recordings are not in it as they are, {found.gone} rows have no recording"
        return fix(name, f"The catalogue in {folder} is not up to date: {told}.", _rebuild(found))
    torn = f"; {found.torn} recordings are not finished (`cell recover`)" if found.torn else ""
    return ok(name, f"{found.rows} cycles{torn}")


def _rebuild(found: Health) -> str:
    took_s = max(1, round(found.unread / _READ_PER_S))
    return f"`cell catalogue rebuild` reads {found.unread} recordings, in about {took_s} s; so does the next list."
