"""Finds a recording by its cycle's id, in the catalogue, so that no folder of a hundred thousand files is listed."""

from __future__ import annotations

from pathlib import Path

from bus.errors import RecordingError
from logs.catalogue.catalogue import open_catalogue
from logs.catalogue.store import THERE
from logs.mcap.index import is_a_path, the_one
from logs.mcap.names import is_folder, shown


def find_recording(name: str, folder: Path) -> Path:
    """Return the recording named ``name``: a file, or a cycle of ``folder`` by its id or an unambiguous part of it.

    Raises: RecordingError when there is none, or more than one; CatalogueError.
    """
    if is_a_path(name):
        return Path(name)  # the reader reports errors of the file
    if not is_folder(folder):
        raise RecordingError(
            f"There is no file {shown(Path(name))}, and no folder {shown(folder)} to look for a cycle in.",
            "Nothing was recorded yet, or name the folder that it lies in: --folder.",
        )
    with open_catalogue(folder, most=0) as catalogue:
        root, listed, gone = catalogue.store.root, catalogue.listed, catalogue.listed.pairs_gone()
        where, given = catalogue.where()
        sql = f"SELECT folder, name FROM cycle WHERE {where} AND {THERE} AND instr(name, ?)"
        found = {
            root / below / file for below, file in catalogue.rows(sql, (*given, name)) if (below, file) not in gone
        }
        found |= {root / file.path for file in (*listed.unknown, *listed.torn, *listed.nameless)}
    return the_one(name, sorted(found, key=lambda path: path.name, reverse=True), folder)
