"""Foxglove's protobuf messages by name, imported at first use, because most programs only send JSON."""

from __future__ import annotations

from importlib import import_module
from typing import Any


class FoxgloveType:
    """Proxy of a message class of ``foxglove_schemas_protobuf``: call it to make a message, or use its attributes."""

    def __init__(self, name: str) -> None:
        self._name = name

    @property
    def full_name(self) -> str:
        """Name of the schema, e.g. ``foxglove.RawImage``."""
        return f"foxglove.{self._name}"

    def __call__(self, **fields: Any) -> Any:
        return self._loaded()(**fields)

    def __getattr__(self, attribute: str) -> Any:
        return getattr(self._loaded(), attribute)

    def _loaded(self) -> Any:
        return getattr(import_module(f"foxglove_schemas_protobuf.{self._name}_pb2"), self._name)
