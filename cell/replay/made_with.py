"""Opens what a recording was made with: robot and models, as they are on this machine, or says what is missing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bus.errors import ConfigError, NotHere, PlugInMissing
from config.keys import value_at
from logs.mcap.reader import PLUG_INS, CycleRecord

_STILL = "`cell show`, `cell report` and read_cycle need none of it."


@contextmanager
def opening(record: CycleRecord, *, is_changed: bool) -> Iterator[None]:
    """Context in which the robot and the models of a recorded station are opened.

    Args:
        is_changed: settings are overridden: a mistake may be in these.

    Raises: NotHere, which names what is missing and what to install; ConfigError of an override.
    """
    try:
        yield
    except PlugInMissing as error:
        if value_at(record.station, error.key) != error.name:
            raise  # of an override
        raise _not_installed(record, error) from error
    except ConfigError as error:
        if is_changed:
            raise
        where = (
            " It holds it as its file model/robot.urdf: --set robot.urdf=FILE." if "robot.urdf" in error.text else ""
        )
        raise NotHere(f"{_whole(record)}: {error.text}", f"{error.advice}{where} {_STILL}".strip()) from error


def _not_installed(record: CycleRecord, error: PlugInMissing) -> NotHere:
    package, _, version = _packages(record).get(error.key, "").partition(" ")
    what = f"it was made with the {error.kind} {error.name!r}"
    if package:
        install = f"Install it beside vlad-cell, as `uv pip install {package}=={version}` does where it is published."
        return NotHere(
            f"{_whole(record)}: {what} of {package} {version}, which is not installed.", f"{install} {_STILL}"
        )
    install = f"Install the package that brings it, as the entry point {error.name!r} of {error.group}."
    return NotHere(f"{_whole(record)}: {what}, and no installed package brings it.", f"{install} {_STILL}")


def _whole(record: CycleRecord) -> str:
    return f"The recording of {record.cycle_id} is whole, and cannot run again here"


def _packages(record: CycleRecord) -> dict[str, str]:
    """The packages as they were recorded; none in older recordings."""
    try:
        named: Any = json.loads(record.metadata.get(PLUG_INS, "{}"))
    except ValueError:
        named = {}
    return {str(key): str(value) for key, value in named.items()} if isinstance(named, dict) else {}
