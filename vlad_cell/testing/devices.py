"""The common part of the suites of the three kinds of devices: the driver's devices, opened and closed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest

from config.plug_ins import Group
from config.schema import Station
from drivers.interface import Devices
from drivers.node.registry import GROUP, open_devices
from vlad_cell.testing.plug_in import PlugInSuite


class DriverSuite(PlugInSuite):
    """A suite for one device of a driver. It connects the device, moves it and closes it: stand clear of a real one."""

    group: ClassVar[Group] = GROUP

    @pytest.fixture(scope="class")
    @classmethod
    def devices(cls, station: Station) -> Iterator[Devices]:
        """Yield the driver's devices, not yet connected."""
        devices = open_devices(cls.name, station, cls.settings)
        yield devices
        for device in (devices.camera, devices.arm, devices.hand):
            if device is not None:
                device.close()
