"""The station that a recorded cycle ran with."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

from bus.distribution import OURS
from bus.errors import ConfigError
from config.load import station_from
from config.schema import Station
from logs.mcap.reader import CycleRecord

_SOURCE = "the recorded station"


def recorded_station(record: CycleRecord, overrides: Sequence[str] = ()) -> Station:
    """Return the station, with these settings changed, as ``key=value``.

    Raises: ConfigError for a wrong override, and for a station that another version recorded and this one cannot read.
    """
    try:
        station = station_from(dict(record.station), source=_SOURCE)
    except ConfigError as error:
        made, here = record.metadata.get(OURS, ""), version(OURS)
        if made in ("", here):
            raise
        what = f"It was recorded by version {made}, and this is {here}: run it with that version."
        raise ConfigError(error.text, what) from error
    return station_from(dict(record.station), overrides, source=_SOURCE) if overrides else station
