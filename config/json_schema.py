"""The JSON schema of a station file, for editors: types, limits, defaults, and what each setting means."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel

from config.field_docs import meanings, summary
from config.schema import Station


def station_schema() -> dict[str, Any]:
    """Return the schema, with the words of the classes' docstrings as descriptions.

    A path and a number are checked by the cell itself more closely than a schema can say.
    """
    schema = Station.model_json_schema()
    tables = {"Station": schema, **schema["$defs"]}
    for model in {one.__name__: one for one in _models(Station)}.values():
        table = tables[model.__name__]
        table["description"] = summary(model)
        for name, text in meanings(model).items():
            if name in table["properties"]:
                table["properties"][name]["description"] = text
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "VLAD Cell station"}


def _models(kind: Any) -> Iterator[type[BaseModel]]:
    """A class of settings, and every one of its fields' types, however deep."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
        for field in kind.model_fields.values():
            yield from _models(field.annotation)
    for one in get_args(kind):
        yield from _models(one)
