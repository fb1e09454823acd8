"""The fields of a message, or of a table of settings, as the reference pages show them: type, range, default, meaning.

The meaning is read from the class's own docstring (its ``Attributes:``) and from the docstrings below its fields.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from itertools import pairwise
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, WithJsonSchema
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

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
_ENTRY = re.compile(r"(?:^|(?<=[.;] ))(``)?(\w+(?:(?:``)?, (?:``)?\w+)*)(?(1)``): ")
"""How a docstring begins to speak of fields: ``one, another: ``, or each in backquotes in the middle of a line."""

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
    """What the class's docstring says before it speaks of its fields, as Markdown."""
    text = " ".join(_docstring(model).split("\n\nAttributes:")[0].split())
    first = next((mark.start() for mark in _marks(text, model)), len(text))
    return markdown(text[:first].rstrip(" ;"))


def rows(model: type[BaseModel], named: Named, given: BaseModel | None = None) -> Iterator[Row]:
    """Its fields, in order; a generic class's fields have the types that they were given.

    Args:
        given: the default of the whole, whose values are the defaults of its fields.
    """
    texts = {**_said_above(model), **_said_below(model)}
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
    """What is accepted besides the type; "" without."""
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


# --- words ------------------------------------------------------------------------------------------------------------


def _docstring(model: type[BaseModel]) -> str:
    """The class's, or that of the generic class which it was made of."""
    return inspect.cleandoc(next(base.__doc__ for base in model.__mro__ if base.__doc__) or "")


def _said_above(model: type[BaseModel]) -> dict[str, str]:
    """By field: what the class's docstring says of it under ``Attributes:``, or elsewhere in the same form."""
    said: dict[str, str] = {}
    for paragraph in _docstring(model).split("\n\n"):
        for entry in re.split(r"\n(?=\S)", textwrap.dedent(paragraph.removeprefix("Attributes:\n"))):
            text = " ".join(entry.split())
            marks = _marks(text, model)
            for mark, end in zip(marks, [*(one.start() for one in marks[1:]), len(text)][: len(marks)], strict=True):
                said |= dict.fromkeys(_names(mark), text[mark.end() : end].strip().rstrip(";"))
    return said


def _marks(text: str, model: type[BaseModel]) -> list[re.Match[str]]:
    """Where a text begins to speak of fields."""
    found = _ENTRY.finditer(text)
    return [mark for mark in found if all(name in model.model_fields for name in _names(mark))]


def _names(mark: re.Match[str]) -> list[str]:
    return mark[2].replace("``", "").split(", ")


def _said_below(model: type[BaseModel]) -> dict[str, str]:
    """By field: the docstring that stands below it."""
    body, said = _body(model), {}
    for field, below in pairwise(body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                said[name] = " ".join(text.split())
    return said


def _body(model: type[BaseModel]) -> list[ast.stmt]:
    """The statements of the class as it is written; none of one that was made of a generic class."""
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    except (OSError, TypeError):
        return []
    return tree.body if isinstance(tree, ast.ClassDef) else []
