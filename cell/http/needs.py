"""Checks that the optional packages of this room are there, before anything of it is imported."""

from __future__ import annotations

from importlib import import_module

from bus.errors import ConfigError

PACKAGES = ("starlette", "uvicorn")


def require_packages() -> None:
    """Raises: ConfigError naming the missing package."""
    for name in PACKAGES:
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(
                f"The HTTP interface needs the package {name}.", "Install it: uv pip install 'vlad-cell[http]'."
            ) from error
