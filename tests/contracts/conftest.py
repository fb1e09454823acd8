"""Every implementation of the device protocols behind the suites of `vlad_cell.testing`: one suite for all.

`IMPLEMENTATIONS` names them, with what each serves; a suite runs on those that serve its device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from bus.session import Bus
from config.schema import Station
from drivers.fr3.arm import Fr3Arm
from drivers.interface import Arm, Devices, ObjectPresenter
from drivers.node.fault_injection import FaultyArm, FaultyCamera, FaultyHand
from drivers.node.node import Node
from drivers.node.registry import open_devices
from drivers.panda_hand.hand import PandaHand
from drivers.remote import RemoteArm, RemoteCamera, RemoteHand, RemotePresenter
from stand_ins.femto_mega.process import femto_mega
from stand_ins.franka import franka_station


def _simulated(station: Station, _stack: ExitStack, _endpoint: str) -> Devices:
    return open_devices("sim", station)


def _remote(station: Station, stack: ExitStack, endpoint: str) -> Devices:
    """The simulated devices, served by a node on one session and used over another."""
    cell = stack.enter_context(Bus.listen(station.cell_id, endpoint))
    node_bus = stack.enter_context(Bus.join(station.cell_id, endpoint))
    node = Node("sim", node_bus, open_devices("sim", station), station)
    node.open()
    stack.callback(node.close)
    parts = (RemoteCamera(cell, 10.0), RemoteArm(cell, 10.0), RemoteHand(cell, 10.0), RemotePresenter(cell, 10.0))
    return Devices(*parts)


def _fr3(station: Station, stack: ExitStack, _endpoint: str) -> Devices:
    return Devices(arm=Fr3Arm(franka_station(station, stack)))


def _panda_hand(station: Station, stack: ExitStack, _endpoint: str) -> Devices:
    return Devices(hand=PandaHand(franka_station(station, stack)))


def _faulty(station: Station, _stack: ExitStack, _endpoint: str) -> Devices:
    """The simulated devices, wrapped by faults that are not there."""
    real = open_devices("sim", station)
    assert real.camera is not None and real.arm is not None and real.hand is not None
    return Devices(FaultyCamera(real.camera), FaultyArm(real.arm), FaultyHand(real.hand), real.presenter)


def _femto_mega(station: Station, stack: ExitStack, _endpoint: str) -> Devices:
    return Devices(camera=femto_mega(stack))


Opener = Callable[[Station, ExitStack, str], Devices]
ALL = {"camera", "arm", "hand"}
IMPLEMENTATIONS: dict[str, tuple[Opener, set[str]]] = {
    "sim": (_simulated, ALL),
    "remote": (_remote, ALL),
    "femto_mega": (_femto_mega, {"camera"}),
    "fr3": (_fr3, {"arm"}),
    "panda_hand": (_panda_hand, {"hand"}),
    "faulty": (_faulty, ALL),
}


MARKS = {"fr3": pytest.mark.realtime, "panda_hand": pytest.mark.xdist_group("franka")}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """``test_arm`` runs on every implementation that serves an arm, and so on."""
    if "devices" in metafunc.fixturenames:
        device = metafunc.module.__name__.rpartition("test_")[2]
        names = [name for name, (_, serves) in IMPLEMENTATIONS.items() if device in serves]
        marked = [pytest.param(name, marks=MARKS.get(name, ())) for name in names]
        metafunc.parametrize("devices", marked, indirect=True, scope="class")


class EveryImplementation:
    """Gives a suite the devices of one implementation after another instead of those of a driver's name."""

    name = "sim"

    @pytest.fixture(scope="class")
    @classmethod
    def devices(
        cls, request: pytest.FixtureRequest, station: Station, new_endpoint: Callable[[], str]
    ) -> Iterator[Devices]:
        """One implementation of the devices, not yet connected."""
        opener, _ = IMPLEMENTATIONS[request.param]
        with ExitStack() as stack:
            devices = opener(station, stack, new_endpoint())
            yield devices
            for device in (devices.camera, devices.arm, devices.hand):
                if device is not None:
                    device.close()


@pytest.fixture
def presenter(devices: Devices, arm: Arm) -> ObjectPresenter:
    assert devices.presenter is not None
    if isinstance(devices.presenter, RemotePresenter):
        devices.presenter.connect()
    return devices.presenter
