"""Encodes and decodes our own messages (JSON), and gives the schema of every payload. Sensors: `bus.sensor_codec`."""

from __future__ import annotations

import functools
import json
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from bus import topics
from bus.commands import BusSchema, Health, TopicSchema
from bus.errors import BadFrame, BadPayload
from bus.first_mistake import first_mistake
from bus.frozen import Message
from bus.lazy import LazyModule

MessageT = TypeVar("MessageT", bound=Message)
Json = dict[str, Any]
"""A JSON object."""
_MAX_SAID = 200
_FIELDS = "Its fields, with their units: docs/bus.md, and over HTTP GET /api/openapi.json."
mcap_schema: Any = LazyModule("mcap_protobuf.schema")


class Schema(NamedTuple):
    """A payload's schema as MCAP stores it; ``encoding`` is ``protobuf`` or ``jsonschema``."""

    name: str
    encoding: str
    data: bytes


def encode(message: Message) -> bytes:
    """Return one of our messages as JSON bytes."""
    return message.model_dump_json().encode()


def decode(payload_type: type[MessageT], payload: bytes) -> MessageT:
    """Parse one of our messages from JSON. Raises: BadPayload, naming the first field that does not fit."""
    try:
        return payload_type.model_validate_json(payload)
    except ValidationError as error:
        why = first_mistake(error, whole="payload")
    except BadFrame as error:
        why = error.text.rstrip(".")
    except Exception as error:  # noqa: BLE001 - NumPy and OpenCV may raise any type on foreign bytes
        why = f"payload: {type(error).__name__}: {error}"
    raise BadPayload(f"Not a valid {payload_type.__name__}: {_line(why)}.", _FIELDS)


def _line(text: str) -> str:
    """Return foreign text as one printable line of limited length."""
    line = "".join(character if character.isprintable() else " " for character in text)
    return line if len(line) <= _MAX_SAID else f"{line[:_MAX_SAID]}..."


@functools.cache
def schema_of(encoding: str) -> Schema:
    """Return the schema behind a Zenoh encoding of the topic table. Raises: BadPayload for an unknown encoding."""
    payload_type = topics.types_by_encoding().get(encoding)
    if payload_type is None:
        raise BadPayload(f"No topic carries the encoding {encoding!r}.")
    name = encoding.partition(";")[2]
    if encoding.startswith("application/protobuf"):
        return Schema(name, "protobuf", mcap_schema.build_file_descriptor_set(payload_type).SerializeToString())
    return Schema(name, "jsonschema", json.dumps(payload_type.model_json_schema()).encode())


def process_in_words(health: bytes) -> str:
    """Name the process that an encoded `Health` comes from, for a person."""
    try:
        return f"process {decode(Health, health).pid}"
    except BadPayload:
        return "a process that does not say which"


def bus_schema() -> BusSchema:
    """Return every topic, and the JSON schema of every JSON payload."""
    rows = tuple(
        TopicSchema(key=one.key, kind=one.kind, acts=one.acts, asks=_encoding(one.asks), says=_encoding(one.says))
        for one in topics.TOPICS
    )
    schemas = {
        encoding: payload_type.model_json_schema()
        for encoding, payload_type in topics.types_by_encoding().items()
        if encoding.startswith("application/json")
    }
    return BusSchema(topics=rows, json_schemas=schemas)


def _encoding(payload_type: Any) -> str:
    return "" if payload_type is None else topics.encoding_of(payload_type)
