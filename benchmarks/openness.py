"""A recording read by other tools: by the plain ``mcap`` package, and by viewers of Foxglove's schemas."""

from __future__ import annotations

from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

_ENCODINGS = {"protobuf": ("protobuf", "foxglove."), "jsonschema": ("json", "vlad.")}
"""Of a schema -> of its messages, and how its name begins: sensor data and pictures are Foxglove's, others ours."""


def trouble(path: Path) -> str:
    """Return what is wrong with a finished recording, or "": every checksum, every message, every channel's schema."""
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            messages = sum(1 for _ in reader.iter_messages())
    except (McapError, OSError) as error:
        return f"{path}: {error}"
    if summary is None or summary.statistics is None or summary.statistics.message_count != messages:
        return f"{path}: it has no summary, or one that counts other messages than the {messages} in it."
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        if schema is None or not schema.data:
            return f"{path}: {channel.topic} has no schema."
        message_encoding, prefix = _ENCODINGS.get(schema.encoding, ("", "?"))
        if channel.message_encoding != message_encoding or not schema.name.startswith(prefix):
            return f"{path}: {channel.topic} is {channel.message_encoding} of {schema.encoding} {schema.name}."
    shown = {schema.name for schema in summary.schemas.values() if schema.name.startswith("foxglove.")}
    return "" if shown else f"{path}: nothing of it is Foxglove's."
