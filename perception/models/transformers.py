"""HuggingFace transformers, an optional package that is imported only when a station asks for it."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pickle import UnpicklingError
from typing import Any

from bus.errors import ConfigError

PACKAGES = ("torch", "torchvision", "transformers")


def require(role: str) -> tuple[Any, Any]:
    """(torch, transformers). Raises: ConfigError when one of `PACKAGES` is missing; ``role``: what needs them."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise ConfigError(
            f"{role} needs torch, torchvision and transformers; missing: {', '.join(missing)}.",
            "Install them: uv pip install 'vlad-cell[models]'.",
        )
    return import_module("torch"), import_module("transformers")


def loaded(weights: str, load: Callable[[], Any]) -> Any:
    """Return the result of ``load``. Raises: ConfigError when the weights are missing, damaged, or of another kind."""
    try:
        return load()
    except _load_errors() as error:
        first = str(error).strip().partition("\n")[0]
        raise ConfigError(
            f"Cannot load the weights {weights!r} ({first}).",
            "Name a folder that save_pretrained wrote, or a hub id (which needs the network, and for some a login).",
        ) from error


def loaded_model(weights: str, kind: Any, device: str) -> Any:
    """A complete model of class ``kind`` in float32 on ``device``, in evaluation mode.

    Raises: ConfigError as `loaded`, when tensors are missing (they would be random), or for a missing device.
    """
    model, report = loaded(weights, lambda: kind.from_pretrained(weights, dtype="float32", output_loading_info=True))
    if report["missing_keys"]:
        raise ConfigError(
            f"The weights {weights!r} lack {len(report['missing_keys'])} tensors of a {kind.__name__}, "
            f"e.g. {min(report['missing_keys'])!r}.",
            "Name the folder of the whole model.",
        )
    try:
        return model.to(device).eval()
    except (RuntimeError, AssertionError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ConfigError(
            f"Torch cannot use the device {device!r} ({first}).", "Use cpu, or install its driver."
        ) from error


def _load_errors() -> tuple[type[Exception], ...]:
    """Exceptions of loading. RuntimeError: tensors of another size. ImportError: the model needs another package."""
    safetensors, hub = import_module("safetensors"), import_module("huggingface_hub.errors")
    formats = (safetensors.SafetensorError, hub.StrictDataclassError, UnpicklingError)
    return OSError, ValueError, KeyError, RuntimeError, ImportError, *formats
