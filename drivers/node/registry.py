"""Maps driver names to devices. Drivers are entry points of the group ``vlad_cell.drivers``; ours: pyproject.toml."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bus.errors import DriverUnavailable
from config.plug_ins import Group
from config.schema import Station
from drivers.interface import Devices
from drivers.node.plug_in_device import named

GROUP = Group("vlad_cell.drivers", kind="driver", key="nodes.NAME.driver", failure=DriverUnavailable)


def open_node(node: str, station: Station) -> Devices:
    """Build (not yet connect) the devices of one node of the station; errors of another package's driver name it.

    Raises: as `open_devices`.
    """
    settings = station.nodes[node]
    devices = open_devices(settings.driver, station, settings.settings, f"nodes.{node}.settings")
    package = GROUP.package_of(settings.driver)
    return named(devices, settings.driver, package) if package else devices


def open_devices(
    name: str, station: Station, settings: Mapping[str, Any] | None = None, where: str = "nodes.NAME.settings"
) -> Devices:
    """Build (not yet connect) the devices of driver ``name``.

    Args:
        settings: of the driver itself, as the station file has them in the table ``where``.

    Raises:
        ConfigError: unknown driver, or a setting that it refuses; the text names it.
        DriverUnavailable: its package cannot be imported here, or it does not start.
    """
    devices = GROUP.opened(name, station, settings or {}, where)
    if not isinstance(devices, Devices):
        what = f"The driver {name!r} gave {type(devices).__name__} and no Devices."
        raise DriverUnavailable(what, "See docs/extend.md, A driver.")
    return devices
