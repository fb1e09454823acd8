"""Reads what the docstrings of a class say of each of its fields: of a settings table, a message or a dataclass.

The words are read from the class's own docstring (its ``Attributes:``) and from the docstrings below its fields. The
reference pages, that of the Python API, `cell config` and the JSON schema of a station show them.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from functools import cache
from importlib import import_module
from itertools import pairwise

from pydantic import BaseModel

_ENTRY = re.compile(r"(?:^|(?<=[.;] ))(``)?(\w+(?:(?:``)?, (?:``)?\w+)*)(?(1)``): ")
"""How a docstring begins to speak of fields: ``one, another: ``, or each in backquotes in the middle of a line."""


def summary(model: type) -> str:
    """Return what the class's docstring says before it speaks of its fields, on one line."""
    text = " ".join(_docstring(model).split("\n\nAttributes:")[0].split())
    first = next((mark.start() for mark in _marks(text, model)), len(text))
    return text[:first].rstrip(" ;")


def meanings(model: type) -> dict[str, str]:
    """Return by field, inherited ones too, what is said of it, on one line; without those of which nothing is said."""
    said: dict[str, str] = {}
    for base in reversed(model.__mro__[:-1]):  # the last is object
        said |= {**_said_above(base), **_said_below(base)}
    return said


def _docstring(model: type) -> str:
    """The class's, or that of the generic class which it was made of."""
    return inspect.cleandoc(next(base.__doc__ for base in model.__mro__ if base.__doc__) or "")


def _said_above(model: type) -> dict[str, str]:
    """By field: what the class's docstring says of it under ``Attributes:``, or elsewhere in the same form."""
    said: dict[str, str] = {}
    for paragraph in _docstring(model).split("\n\n"):
        for entry in re.split(r"\n(?=\S)", textwrap.dedent(paragraph.removeprefix("Attributes:\n"))):
            text = " ".join(entry.split())
            marks = _marks(text, model)
            for mark, end in zip(marks, [*(one.start() for one in marks[1:]), len(text)][: len(marks)], strict=True):
                said |= dict.fromkeys(_names(mark), text[mark.end() : end].strip().rstrip(";"))
    return said


def _marks(text: str, model: type) -> list[re.Match[str]]:
    """Return where a text begins to speak of fields."""
    fields = _fields(model)
    return [mark for mark in _ENTRY.finditer(text) if fields.issuperset(_names(mark))]


def _fields(model: type) -> set[str]:
    """The fields of a pydantic model, those that it inherits among them; of another class the ones it annotates."""
    return set(model.model_fields) if issubclass(model, BaseModel) else set(inspect.get_annotations(model))


def _names(mark: re.Match[str]) -> list[str]:
    return mark[2].replace("``", "").split(", ")


def _said_below(model: type) -> dict[str, str]:
    """By field: the docstring that stands below it."""
    body, said = _body(model), {}
    for field, below in pairwise(body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                said[name] = " ".join(text.split())
    return said


def _body(model: type) -> list[ast.stmt]:
    """The statements of the class as it is written; none of one that was made of a generic class."""
    return _classes(model.__module__).get(model.__name__, [])


@cache
def _classes(module: str) -> dict[str, list[ast.stmt]]:
    """The statements of each class at the top of a module, by name; none where it has no source."""
    try:
        tree = ast.parse(inspect.getsource(import_module(module)))
    except (OSError, TypeError):
        return {}
    return {one.name: one.body for one in tree.body if isinstance(one, ast.ClassDef)}
