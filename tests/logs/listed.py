"""The list of recordings: as the catalogue gives it, and as the files say, without a catalogue."""

from __future__ import annotations

from pathlib import Path

from logs.catalogue import open_catalogue
from logs.mcap.index import Entry, Filter, read_entry, recordings


def listed(folder: Path, wanted: Filter | None = None) -> list[Entry]:
    """What every list of the product reads."""
    with open_catalogue(folder) as catalogue:
        return list(catalogue.entries(wanted))


def in_the_files(folder: Path, wanted: Filter | None = None) -> list[Entry]:
    """The same, of every file that is there."""
    wanted = (wanted or Filter()).at_one_time()
    entries = filter(wanted.takes, map(read_entry, filter(wanted.dates, recordings(folder))))
    return sorted(entries, key=lambda entry: wanted.age(entry.by_age), reverse=True)[: wanted.last]
