"""Answers about recordings: the list of cycles, their small pictures, figures of a day, what persons say of them."""

from __future__ import annotations

import re
import time
from collections import defaultdict
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote

from pydantic import Field
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bus.codec import decode
from bus.errors import BadPayload, ConfigError, RecordingError
from bus.frozen import Message
from cell.http.access import require_right
from cell.http.answers import say
from cell.http.door import Door
from cell.http.page_files import FOLDER
from logs.catalogue import open_catalogue
from logs.catalogue.figures import Counts, Summary, summed
from logs.catalogue.labels import Label, append, read_labels
from logs.mcap.index import Filter, day_named
from logs.mcap.names import is_folder
from logs.thumbnail import thumbnail

_USUAL, _MOST = 20, 500
_KEPT = 64
"""Small pictures in memory."""
_READ_FIRST = 32
"""So many recordings without a row are read before figures are told: half a second; more are left to the cell."""
_CYCLE = re.compile(r"(\d{4})(\d{2})(\d{2})T\d{9}")


class Verdict(Message):
    """The verdict of a person about a cycle.

    Attributes:
        who: the person. ``label``: "" for a mere note.
    """

    who: Annotated[str, Field(min_length=1, max_length=100)]
    label: Literal["good", "bad", ""] = ""
    note: Annotated[str, Field(max_length=1000)] = ""


async def cycles(request: Request, door: Door) -> Response:
    """Answer the newest recordings, with the paths of their files here. Raises: BadPayload."""
    limit = _limit(request.query_params.get("limit", str(_USUAL)))
    failed = request.query_params.get("failed", "")
    if failed not in ("", "true"):
        raise BadPayload("failed: true, for only those that failed.", "Leave it out for all.")
    return JSONResponse(await door.ask(partial(_listed, door.recordings, Filter(failed=bool(failed), last=limit))))


def _limit(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 6 and 1 <= int(text) <= _MOST):
        raise BadPayload(f"limit: a number from 1 to {_MOST}.", "Leave it out for the usual one.")
    return int(text)


def _listed(folder: Path, wanted: Filter) -> list[dict[str, Any]]:
    """Raises: RecordingError, CatalogueError: a list that cannot be had is none, and not an empty one."""
    if not is_folder(folder):  # nothing was recorded yet
        return []
    with open_catalogue(folder, most=0) as catalogue:
        entries = list(catalogue.entries(wanted))
    said = defaultdict(list)
    for label in read_labels(folder):
        said[label.cycle_id].append(label.model_dump())
    return [{**entry.to_json(), **_paths(entry.path, folder), "labels": said[entry.cycle_id]} for entry in entries]


def _paths(file: Path, folder: Path) -> dict[str, str]:
    """Return where a recording and its report are served; "" for what is not there."""
    page = file.with_suffix(".html")
    return {
        "file": f"/recordings/{_quoted(file, folder)}" if file.suffix == ".mcap" else "",
        "report": f"/reports/{_quoted(page, folder)}" if page.is_file() else "",
    }


def _quoted(file: Path, folder: Path) -> str:
    return quote(bytes(file.relative_to(folder)))


async def small_picture(request: Request, door: Door) -> Response:
    """Answer the thumbnail of a cycle; a sign for one that has shown nothing. Raises: RecordingError."""
    path = _recording(door.recordings, request.path_params["cycle_id"])
    headers = {"ETag": f'"{path.stem}"', "Cache-Control": "no-cache"}
    if request.headers.get("if-none-match") == headers["ETag"]:
        return Response(status_code=304, headers=headers)
    found = await door.ask(partial(_small, path))
    if found is None:
        return FileResponse(FOLDER / "no-picture.svg")
    return Response(found, media_type="image/jpeg", headers=headers)


@lru_cache(_KEPT)
def _small(path: Path) -> bytes | None:
    return thumbnail(path)


def _recording(folder: Path, cycle_id: str) -> Path:
    """The finished recording of a cycle. Raises: RecordingError."""
    named = _CYCLE.fullmatch(cycle_id)
    day = folder / "-".join(named.groups()) if named is not None else folder
    for path in (day / f"{cycle_id}.mcap", day / f"{cycle_id}.recovered.mcap"):
        if named is not None and path.is_file():
            return path
    raise RecordingError("There is no recording of this cycle.", "See GET /api/cycles.")


async def summary(request: Request, door: Door) -> Response:
    """Answer the figures of ``cell cycles --summary --json``. Raises: BadPayload."""
    day = request.query_params.get("day", "")
    try:
        named = day_named(day)
    except ConfigError as error:
        raise BadPayload(f"day: {error.text}", f"{error.advice} Leave it out for all days.") from error
    return JSONResponse((await door.ask(partial(_summed, door.recordings, named))).to_json())


def _summed(folder: Path, day: str) -> Summary:
    """Raises: RecordingError, CatalogueError."""
    if not is_folder(folder):  # nothing was recorded yet
        return Summary(Counts(), {})
    with open_catalogue(folder, most=_READ_FIRST) as catalogue:
        return summed(catalogue, day)


async def verdict(request: Request, door: Door) -> Response:
    """Keep what a person says of a cycle, beside the recordings. Raises: BadPayload, RecordingError, Refused."""
    require_right(request.state.role, "label")
    said = decode(Verdict, await request.body())
    if not (said.label or said.note.strip()):
        raise BadPayload("label: it says nothing.", "Say good, bad or a note.")
    cycle_id = request.path_params["cycle_id"]
    _recording(door.recordings, cycle_id)
    kept = Label(cycle_id=cycle_id, at_ns=time.time_ns(), who=said.who, label=said.label, note=said.note.strip())
    await door.ask(partial(append, door.recordings, kept))
    return say(kept)
