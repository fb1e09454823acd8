"""The composition root: the only module that connects bus, drivers, planning, perception and the daemon."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING, Any

from bus.errors import ConfigError
from bus.lazy import LazyModule
from bus.secured import is_loopback
from bus.session import Bus
from bus.threads import handled_by
from cell.daemon.cataloguer import Cataloguer
from cell.daemon.daemon import Daemon
from cell.daemon.publisher import Observer
from cell.daemon.retention import Retention
from cell.daemon.robot_tf import RobotTf
from cell.nodes.process import freeze_gc, limit_malloc_arenas
from cell.nodes.supervisor import Supervisor
from config.clock import clock_of
from config.schema import Station
from drivers.node import registry
from drivers.remote import remote_devices
from logs.mcap.recorder import plain
from logs.mcap.recover import recover_leftovers
from perception.models import Models, open_models
from planning.robot import Robot

if TYPE_CHECKING:
    from cell import fault_injection
else:
    fault_injection = LazyModule("cell.fault_injection")  # only where faults are allowed


class _News:
    """Passes news of nodes and recordings on to the daemon, which is built after those who have them."""

    def __init__(self) -> None:
        self.daemon: Daemon | None = None

    def node_ended(self, name: str, code: int) -> None:
        if self.daemon is not None:
            self.daemon.lose_node(name, f"The node {name!r} ended with exit code {code}.")

    def node_is_back(self, name: str) -> None:
        if self.daemon is not None:
            self.daemon.welcome_node(name)

    def event(self, *said: Any) -> None:
        if self.daemon is not None:
            self.daemon.publisher.publish_event(*said)


@contextmanager
def running_cell(station: Station, observer: Observer) -> Iterator[Daemon]:
    """A whole cell: bus, its local nodes, daemon. All of it is closed again on every path.

    Raises: ConfigError, PortOccupied, DriverUnavailable and the errors of a node that cannot start.
    """
    limit_malloc_arenas()
    for node in station.nodes.values():
        registry.GROUP.require(node.driver)
    robot, news = Robot(station), _News()
    faults = fault_injection.FaultInjection(station) if station.faults.allowed else None
    with ExitStack() as stack:
        models = stack.enter_context(closing(_models(station, faults)))
        bus = stack.enter_context(_listen(station))
        supervisor = stack.enter_context(closing(Supervisor(station, news.node_ended, news.node_is_back, bus.seal)))
        retention = Retention(station.recording, news.event)
        cataloguer = Cataloguer(station.recording.folder, news.event)
        supervisor.start()
        daemon = news.daemon = Daemon(
            station,
            bus,
            remote_devices(bus, station),
            robot,
            models,
            cataloguer.after_cycles(retention.after_cycles(observer)),
            supervisor.restarts,
            supervisor.end_frozen,
            plain if faults is None else faults.under,
        )
        if faults is not None:
            faults.answer(bus, daemon.publisher.publish)
        stack.enter_context(handled_by(daemon.on_defect))
        stack.enter_context(closing(cataloguer))  # closed after the daemon, whose end closes a cycle
        daemon.open()
        stack.callback(daemon.close)
        daemon.publisher.publish_recovered(recover_leftovers(station.recording.folder))
        stack.enter_context(freeze_gc())
        stack.enter_context(closing(retention.start()))
        cataloguer.start()
        stack.enter_context(closing(RobotTf(bus, robot, daemon.is_ours)))
        yield daemon


def _models(station: Station, faults: fault_injection.FaultInjection | None) -> Models:
    """Open the models, with fault injection where the station allows it. Raises: as `open_models`."""
    models = open_models(station, os.environ)
    return models if faults is None else faults.around(models)


def _listen(station: Station) -> Bus:
    """Open the cell's listening session. Raises: ConfigError, PortOccupied."""
    settings = station.bus
    if not is_loopback(settings.endpoint):
        raise ConfigError(
            f"The cell's own endpoint must be on loopback, not {settings.endpoint}.",
            "For other machines set bus.listen, or bus.router, beside it; see docs/security.md.",
        )
    return Bus.listen(
        station.cell_id,
        settings.endpoint,
        beyond=settings.listen,
        router=settings.router,
        security=settings.zenoh,
        clock=clock_of(station),
    )
