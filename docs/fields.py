"""The fields of a message, or of a table of settings, as the reference pages show them: type, range, default, meaning.

The meaning is read from the class's own docstring (its ``Attributes:``) and from the docstrings below its fields.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, WithJsonSchema
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from config.field_docs import meanings, summary

_SIMPLE: dict[Any, str] = {
    str: "string",
    int: "integer",
    float: "number",
    bool: "boolean",
    bytes: "bytes",
    NoneType: "null",
    Any: "anything",
    Path: "path",
}
_BOUNDS = {
    "ge": "≥ {}",
    "gt": "> {}",
    "le": "≤ {}",
    "lt": "< {}",
    "multiple_of": "multiple of {}",
    "min_length": "at least {} long",
    "max_length": "at most {} long",
    "pattern": "`{}`",
}
Named = Callable[[type], str]
"""How a page shows a message or an enumeration that is the type of a field."""


class Row(NamedTuple):
    """One field. ``default``: as JSON; None where the field must be given, "" where it is a table of its own."""

    name: str
    type: str
    limits: str
    default: str | None
    text: str


def lead(model: type[BaseModel]) -> str:
    """Return what the class's docstring says before it speaks of its fields, as Markdown."""
    return markdown(summary(model))


def rows(model: type[BaseModel], named: Named, given: BaseModel | None = None) -> Iterator[Row]:
    """Its fields, in order; a generic class's fields have the types that they were given.

    Args:
        given: the default of the whole, whose values are the defaults of its fields.
    """
    texts = meanings(model)
    for name, field in model.model_fields.items():
        shown = type_in_words(field.annotation, named, field.metadata)
        default = _default(field) if given is None else as_json(getattr(given, name))
        yield Row(name, shown, _limits(field), default, markdown(texts.get(name, "")))


def markdown(text: str) -> str:
    """A docstring's words, for a cell of a table."""
    text = text[:1].upper() + text[1:] if re.match(r"[a-z]+(?:[ ,.]|$)", text) else text
    return text.replace("``", "`").replace("|", "\\|")


# --- types ------------------------------------------------------------------------------------------------------------


def type_in_words(kind: Any, named: Named, metadata: Sequence[Any] = ()) -> str:
    """A field's type: what of JSON, or of TOML, it is."""
    schema = next((one.json_schema for one in metadata if isinstance(one, WithJsonSchema)), None)
    if schema is not None:
        return _array(schema)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return type_in_words(arguments[0], named, arguments[1:])
    if origin in (Union, UnionType):
        return " or ".join(type_in_words(one, named) for one in arguments)
    if origin is Literal:
        return " or ".join(f"`{one if isinstance(one, str) else json.dumps(one)}`" for one in arguments)
    if origin is dict:
        return "object" if arguments[1] is Any else f"object of {type_in_words(arguments[1], named)} by name"
    if origin in (tuple, list):
        return _list([type_in_words(one, named) for one in arguments if one is not ...], is_fixed=... not in arguments)
    return _SIMPLE[kind] if kind in _SIMPLE else named(kind)


def _list(kinds: list[str], *, is_fixed: bool) -> str:
    if not is_fixed:
        return f"list of {kinds[0]}"
    return f"{len(kinds)} x {kinds[0]}" if len(set(kinds)) == 1 else f"list: {', '.join(kinds)}"


def _array(schema: dict[str, Any]) -> str:
    """An array by its shape, an image, or bytes (`bus.arrays`)."""
    if "anyOf" not in schema:
        return "PNG image" if "png" in schema.get("properties", {}) else "bytes in base64"
    lengths, of = [], schema["anyOf"][0]
    while of["type"] == "array":
        least, most = of.get("minItems", "n"), of.get("maxItems", "n")
        lengths.append(str(least) if least == most else f"({least} to {most})")
        of = of["items"]
    return f"array {' x '.join(lengths)}"


def _limits(field: FieldInfo) -> str:
    """Return what is accepted besides the type; "" without."""
    found = []
    for one in field.metadata:
        given = {name: getattr(one, name, None) for name in _BOUNDS}
        found += [_BOUNDS[name].format(value) for name, value in given.items() if value is not None]
    return ", ".join(found)


def _default(field: FieldInfo) -> str | None:
    value = field.get_default(call_default_factory=True)
    return None if value is PydanticUndefined else as_json(value)


def as_json(value: Any) -> str:
    """A default as it is written in a file."""
    if isinstance(value, BaseModel):
        return ""
    if isinstance(value, tuple):
        return f"[{', '.join(as_json(one) for one in value)}]"
    return json.dumps(str(value) if isinstance(value, (Enum, Path)) else value)
