"""Checks that this room can be served, before anything of it is imported or started."""

from __future__ import annotations

import os
from importlib.util import find_spec

from bus.errors import ConfigError
from cell.http.access import Access
from config.schema import Station

_PACKAGES = ("starlette", "uvicorn")


def require(station: Station) -> None:
    """Raises: ConfigError without the optional packages, or for settings that are not safe (`Access.of`)."""
    for name in _PACKAGES:
        if find_spec(name) is None:
            raise ConfigError(
                f"The HTTP interface needs the package {name}.", "Install it: uv pip install 'vlad-cell[http]'."
            )
    Access.of(station.http, os.environ)
