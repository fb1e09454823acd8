"""``GET /api/storage``: the room on the disk, and what will be deleted next."""

from __future__ import annotations

import shutil
import time
from functools import partial
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from cell.http.door import Door
from config.recording import RecordingSettings
from logs.catalogue import open_catalogue
from logs.mcap.names import is_folder
from logs.prune import Pruner


async def storage(_request: Request, door: Door) -> Response:
    """Free and used bytes, the limits, and the recordings that go within a day. Raises: RecordingError."""
    return JSONResponse(await door.ask(partial(_told, door.station.recording)))


def _told(settings: RecordingSettings) -> dict[str, Any]:
    disk = shutil.disk_usage(_existing(settings.folder))
    plan = Pruner(settings, lambda: time.sleep(0.001)).plan()
    due = [one.file for one in (*plan.delete, *plan.soon)]
    return {
        "free_bytes": disk.free,
        "total_bytes": disk.total,
        "recordings_bytes": _recorded_bytes(settings.folder),
        "rules": settings.rules,
        "soon": {"recordings": len(due), "bytes": sum(one.bytes for one in due), "trimmed": len(plan.thin)},
        "short": plan.short,
    }


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that exists."""
    folder = folder.absolute()
    return next(one for one in (folder, *folder.parents) if one.is_dir())


def _recorded_bytes(folder: Path) -> int:
    """By the catalogue, which knows the size of every finished recording."""
    if not is_folder(folder):
        return 0
    with open_catalogue(folder, most=0) as catalogue:
        ((total,),) = catalogue.rows("SELECT coalesce(sum(bytes), 0) FROM cycle")
    return int(total)
