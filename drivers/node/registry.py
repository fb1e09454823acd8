"""Maps driver names to devices. Drivers are entry points of the group ``vlad_cell.drivers``; ours: pyproject.toml."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points

from bus.errors import ConfigError, DriverUnavailable
from config.schema import Station
from drivers.interface import Devices

GROUP = "vlad_cell.drivers"


def names() -> tuple[str, ...]:
    """Return the installed drivers' names, sorted."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def require(name: str) -> None:
    """Raises: ConfigError, listing the installed drivers, when none is called ``name``."""
    if name not in names():
        raise ConfigError(f"Unknown driver {name!r}.", f"Installed drivers: {', '.join(names())}.")


def open_devices(name: str, station: Station) -> Devices:
    """Build (not yet connect) the devices of driver ``name``.

    Raises:
        ConfigError: unknown driver.
        DriverUnavailable: its package cannot be imported here.
    """
    require(name)
    (point, *_) = entry_points(group=GROUP, name=name)
    try:
        factory: Callable[[Station], Devices] = point.load()
    except ImportError as error:
        raise DriverUnavailable(f"The driver {name!r} cannot be loaded: {error}.", "Install what it needs.") from error
    return factory(station)
