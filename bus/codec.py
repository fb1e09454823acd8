"""Our own messages to JSON and back, and the schemas of whatever travels; sensor data: `bus.wire`."""

from __future__ import annotations

import functools
import json
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from bus import topics
from bus.errors import BadPayload
from bus.frozen import Message
from bus.lazy import LazyModule

MessageT = TypeVar("MessageT", bound=Message)
mcap_schema: Any = LazyModule("mcap_protobuf.schema")


class Schema(NamedTuple):
    """A payload's schema as MCAP stores it; ``encoding`` is ``protobuf`` or ``jsonschema``."""

    name: str
    encoding: str
    data: bytes


def encode(message: Message) -> bytes:
    """One of our messages as JSON."""
    return message.model_dump_json().encode()


def decode(payload_type: type[MessageT], payload: bytes) -> MessageT:
    """One of our messages from JSON. Raises: BadPayload, naming the first field that does not fit."""
    try:
        return payload_type.model_validate_json(payload)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "payload"
        raise BadPayload(f"Not a valid {payload_type.__name__}: {where}: {first['msg']}.") from error


@functools.cache
def schema_of(encoding: str) -> Schema:
    """The schema behind a Zenoh encoding of the topic table. Raises: BadPayload for an unknown one."""
    payload_type = topics.types_by_encoding().get(encoding)
    if payload_type is None:
        raise BadPayload(f"No topic carries the encoding {encoding!r}.")
    name = encoding.partition(";")[2]
    if encoding.startswith("application/protobuf"):
        return Schema(name, "protobuf", mcap_schema.build_file_descriptor_set(payload_type).SerializeToString())
    return Schema(name, "jsonschema", json.dumps(payload_type.model_json_schema()).encode())
