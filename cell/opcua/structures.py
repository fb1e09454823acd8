"""PackML's structures for counts and alarms, as asyncua wants them: registered once a process, by their node ids."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from datetime import UTC, datetime

from asyncua import Server, ua
from asyncua.common.manage_nodes import create_data_type, create_encoding
from asyncua.common.structures104 import new_struct_field

from cell.opcua.packml import ALARM, BINARY_ENCODINGS, COUNT

_NEVER = datetime(1601, 1, 1, tzinfo=UTC)
"""OPC UA's zero."""


@dataclass
class PackMLCountDataType:
    """A count of something that happened. ``Count``: on this job; ``AccCount``: altogether."""

    ID: ua.Int32 = 0
    Name: ua.String = None
    Unit: ua.EUInformation = field(default_factory=ua.EUInformation)
    Count: ua.Int32 = 0
    AccCount: ua.Int32 = 0


@dataclass
class PackMLAlarmDataType:
    """An alarm, or a reason to stop. ``Trigger``: it is active."""

    ID: ua.Int32 = 0
    Value: ua.Int32 = 0
    Message: ua.String = None
    Category: ua.Int32 = 0
    DateTime: ua.DateTime = _NEVER
    AckDateTime: ua.DateTime = _NEVER
    Trigger: ua.Boolean = False


_STRUCTURES = {COUNT: PackMLCountDataType, ALARM: PackMLAlarmDataType}
_TYPES = {
    "Int32": ua.NodeId(ua.ObjectIds.Int32),
    "String": ua.NodeId(ua.ObjectIds.String),
    "EUInformation": ua.NodeId(ua.ObjectIds.EUInformation),
    "DateTime": ua.NodeId(ua.ObjectIds.UtcTime),
    "Boolean": ua.NodeId(ua.ObjectIds.Boolean),
}


def count(name: str, number: int) -> PackMLCountDataType:
    """A count of ``number`` since this server began."""
    return PackMLCountDataType(ID=1, Name=name, Count=number, AccCount=number)


def alarm(code: str, text: str, severity: int, *, is_active: bool, when: datetime) -> PackMLAlarmDataType:
    """An alarm with this code of ours; its number is made of it, and always the same.

    Args:
        severity: 0 = information, 1 = warning, 2 = error.
        when: UTC.
    """
    number = zlib.crc32(code.encode()) & 0x7FFFFFFF if code else 0
    return PackMLAlarmDataType(
        ID=number, Message=f"{code}: {text}" if code else text, Category=severity, DateTime=when, Trigger=is_active
    )


async def add_structures(server: Server, index: int) -> None:
    """Add both data types to the namespace ``index``, with their definitions, and register them for encoding."""
    for node, kind in _STRUCTURES.items():
        named = ua.QualifiedName(kind.__name__, index)
        data_type = await create_data_type(server.nodes.base_structure_type, ua.NodeId(node, index), named)
        encoding_id = ua.NodeId(BINARY_ENCODINGS[node], index)
        await create_encoding(data_type, encoding_id, ua.QualifiedName("Default Binary", 0))
        annotated = {name: str(hint).removeprefix("ua.") for name, hint in kind.__annotations__.items()}
        definition = ua.StructureDefinition()
        definition.StructureType = ua.StructureType.Structure
        definition.BaseDataType = server.nodes.base_structure_type.nodeid
        definition.DefaultEncodingId = encoding_id
        definition.Fields = [new_struct_field(name, _TYPES[hint]) for name, hint in annotated.items()]
        await data_type.write_data_type_definition(definition)
        ua.register_extension_object(kind.__name__, encoding_id, kind, ua.NodeId(node, index))


def utc_of(stamp_ns: int) -> datetime:
    """Return the time of a stamp; of one that cannot be, as another program may send, the time now."""
    try:
        return datetime.fromtimestamp(stamp_ns * 1e-9, UTC)
    except (OverflowError, ValueError, OSError):
        return datetime.now(UTC)
