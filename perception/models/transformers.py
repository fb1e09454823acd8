"""HuggingFace transformers, if it is installed: an optional part that nothing imports unless a station asks for it."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from bus.errors import ConfigError

PACKAGES = ("torch", "torchvision", "transformers")


def require(role: str) -> tuple[Any, Any]:
    """(torch, transformers). Raises: ConfigError when they are missing; ``role`` is what needs them."""
    if find_spec("torch") is None or find_spec("transformers") is None:
        raise ConfigError(f"{role} needs torch and transformers.", "Install them: uv pip install 'vlad-cell[models]'.")
    return import_module("torch"), import_module("transformers")


def loaded(weights: str, load: Callable[[], Any]) -> Any:
    """What ``load`` gives. Raises: ConfigError when the weights are not there or are something else."""
    try:
        return load()
    except (OSError, ValueError, KeyError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ConfigError(
            f"Cannot load the weights {weights!r} ({first}).",
            "Name a folder that save_pretrained wrote, or a hub id (which needs the network, and for some a login).",
        ) from error
