"""Modules that are imported at first use, so that a program that only sends "stop" does not wait for OpenCV."""

from __future__ import annotations

from importlib import import_module
from typing import Any


class LazyModule:
    """Proxy of a module, which is imported when the first attribute is read."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(import_module(self._name), attribute)
        setattr(self, attribute, value)
        return value
