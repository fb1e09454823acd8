"""Trims a recording: a copy without its pictures takes its place, and everything else is as it was recorded.

Left out are colour and depth frames, the pictures and points that viewers are shown, and what goal-image models drew.
In the record of detect, a grey picture of the same size stands for each; outlines stay.
"""

from __future__ import annotations

import base64
import json
import os
import re
import struct
from functools import cache
from pathlib import Path

import numpy as np
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from bus import topics
from bus.atomic import written_atomically
from bus.errors import RecordingError
from bus.packing import pack_image
from logs.mcap.finished_reader import records
from logs.mcap.names import reading, shown
from logs.mcap.recorder import MODE
from logs.mcap.writer import McapFile

THINNED = "thinned_ns"
"""Metadata key of a trimmed recording: when it was, UTC [ns]."""
ARCHIVED, ARCHIVED_SHA256 = "archived", "archived_sha256"
"""Metadata keys of a trimmed recording: address of the whole one, and its checksum."""
_CAMERA = frozenset({f"/{topics.CAMERA_COLOR.key}", f"/{topics.CAMERA_DEPTH.key}"})
_VIEWS = frozenset(f"/{topic.key}" for topic in (topics.VIEW_COLOR, topics.VIEW_GOAL, topics.VIEW_CLOUD))
_WITH_PICTURES = frozenset({f"/{topics.DETECT.key}", f"/{topics.MODEL_REPLY.key}"})
_PICTURE = re.compile(rb'"(color|goal_image)":\s*\{"png":\s*"([^"]*)"\}')
_DRAWN = re.compile(rb'"image_png":\s*"[^"]*"')
_GREY = 128


def thin(path: Path, at_ns: int, archived: str = "", sha256: str = "") -> int:
    """Replace a finished recording by one without its pictures; return how many bytes that freed.

    Its time of change stays, so that its page remains current.

    Args:
        at_ns: now, UTC. ``archived``, ``sha256``: where the whole recording is, and its checksum; "" for nowhere.

    Raises: RecordingError; the recording is as it was then.
    """
    where = {ARCHIVED: archived, ARCHIVED_SHA256: sha256} if archived else {}
    with reading(path), path.open("rb") as source:
        before = os.fstat(source.fileno())
        try:
            with written_atomically(path, mode=MODE) as target:
                copy = _Copy(McapFile(target))
                for record in records(source):
                    copy.add(record)
                copy.out.metadata("thinned", {THINNED: str(at_ns), **where})
                copy.out.finish()
                target.flush()
                os.utime(target.fileno(), ns=(before.st_atime_ns, before.st_mtime_ns))
        except OSError as error:
            raise RecordingError(
                f"{shown(path)} cannot be trimmed: {error.strerror or error}.", "Check the disk's space and rights."
            ) from error
        return before.st_size - path.stat().st_size


class _Copy:
    """Writes the records that stay, under ids of its own."""

    def __init__(self, out: McapFile) -> None:
        self.out = out
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._topics: dict[int, str] = {}

    def add(self, record: McapRecord) -> None:
        match record:
            case Schema():
                self._schemas[record.id] = self.out.schema(record.name, record.encoding, record.data)
            case Channel() if record.topic not in _CAMERA | _VIEWS:
                schema_id = self._schemas.get(record.schema_id, 0)
                self._channels[record.id] = self.out.channel(record.topic, record.message_encoding, schema_id)
                self._topics[record.id] = record.topic
            case Message() if record.channel_id in self._channels:
                data = without_frames(record.data) if self._topics[record.channel_id] in _WITH_PICTURES else record.data
                channel_id = self._channels[record.channel_id]
                self.out.message(channel_id, record.log_time, data, record.publish_time, record.sequence)
            case Attachment() if not record.media_type.startswith("image/"):
                self.out.attachment(record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                self.out.metadata(record.name, record.metadata)
            case _:
                pass


def without_frames(payload: bytes) -> bytes:
    """Return the message (JSON) with its colour pictures grey, of the same size, and without those of a model."""
    return _DRAWN.sub(b'"image_png": null', _PICTURE.sub(lambda one: b'"%s":%s' % (one[1], _grey(one[2])), payload))


def _grey(png: bytes) -> bytes:
    """A grey picture of the size that the head of a PNG (base64) says."""
    width, height = struct.unpack(">II", base64.b64decode(png[:40])[16:24])
    return _grey_of(width, height)


@cache
def _grey_of(width: int, height: int) -> bytes:
    return json.dumps(pack_image(np.full((height, width, 3), _GREY, np.uint8))).encode()
