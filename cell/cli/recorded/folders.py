"""The recordings folder that a command works in, and the cycle that it finds there: one word for it, ``--folder``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from bus.errors import ConfigError, RecordingError
from config.load import load_station
from logs.catalogue.finding import find_recording
from logs.catalogue.journal import last_of
from logs.catalogue.update import root_of
from logs.mcap.names import is_folder, printable, shown

_ROW = 'Its row is still in the catalogue: `cell query "SELECT * FROM cycles WHERE cycle_id = ..."`.'

InFolder = Annotated[
    Path | None,
    typer.Option(
        "--folder",
        metavar="FOLDER",
        help="Work in this folder of recordings; a cycle's id is looked for there.",
        show_default="recording.folder of the station",
    ),
]
"""Of every command that reads or keeps recordings."""
Folder = Annotated[Path | None, typer.Argument(metavar="FOLDER", help="The same as --folder.", show_default=False)]
"""Beside it where nothing else has to be named."""
Cycle = Annotated[
    str, typer.Argument(metavar="FILE|CYCLE", help="A recording (.mcap), or a cycle's id or a part of it.")
]


def folder_of(config: Path, named: Path | None, also: Path | None = None) -> Path:
    """Return the folder of recordings: the one that is named, by option or argument, else the station's.

    Raises: RecordingError when a named one does not exist; ConfigError when both are named and differ, and of the
        station.
    """
    if named is not None and also is not None and named != also:
        raise ConfigError(f"Two folders are named: {shown(also)} and --folder {shown(named)}.", "Name one of them.")
    folder = also if named is None else named
    if folder is None:
        return load_station(config).recording.folder
    if not is_folder(folder):
        raise _no_folder(shown(folder))
    return folder


def _no_folder(name: str) -> RecordingError:
    return RecordingError(f"There is no folder {printable(name)}.", "Name the one that the recordings are in.")


def is_all_of(name: str, folder: Path | None) -> bool:
    """Whether a command's FOLDER is named: all recordings of it. Raises: ConfigError when ``--folder`` is, too."""
    if is_folder(Path(name)) and folder is not None:
        raise ConfigError(
            f"Two folders are named: {shown(Path(name))} and --folder {shown(folder)}.",
            "--folder says where a cycle's id is looked for; leave it out for all recordings of a folder.",
        )
    return is_folder(Path(name))


def find_cycle(name: str, config: Path, folder: Path | None = None) -> Path:
    """Return the recording named by a command's FILE|CYCLE. Raises: RecordingError, ConfigError."""
    if name.endswith(os.sep) and not is_folder(Path(name)):  # a path has no slash at its end any more
        raise _no_folder(name)
    root = folder_of(config, folder)
    try:
        return find_recording(name, root)
    except RecordingError as error:
        gone = last_of(root, name)
        if gone is None:
            raise
        raise RecordingError(f"The recording of {gone.cycle_id} was {gone.in_words()}.", _ROW) from error


def root_of_labels(path: Path, config: Path, folder: Path | None = None) -> Path:
    """Return the folder whose labels are of a recording: that of `folder_of`, if it lies there. Raises: as that."""
    root = folder_of(config, folder)
    return root if path.resolve().is_relative_to(root.resolve()) else root_of(path.parent)[0]
