"""Checks that the optional package of this room is there, before anything of it is imported."""

from __future__ import annotations

from importlib.util import find_spec

from bus.errors import ConfigError


def require_package() -> None:
    """Raises: ConfigError without asyncua. It is only looked for: importing it takes 2 s and 80 MB."""
    if find_spec("asyncua") is None:
        raise ConfigError(
            "The OPC UA interface needs the package asyncua.", "Install it: uv pip install 'vlad-cell[opcua]'."
        )
