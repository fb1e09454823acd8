"""The devices of the simulated cell, as driver ``sim`` of the registry."""

from __future__ import annotations

from bus.commands import Presented, PresentedObject, PresentRequest
from bus.errors import ConfigError
from config.schema import Station
from drivers.interface import Devices
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.hand import SimHand
from drivers.sim.objects import name_in_order
from drivers.sim.world import World

_ADVICE = "Leave the object out, or set sim.clutter = 0."


class SimPresenter:
    """Puts objects on the table: a named one, or the next of a seeded order in which each comes once a round.

    A table filled with several objects (`sim.clutter`) stays as it is.
    """

    def __init__(self, world: World) -> None:
        self._world = world

    def present(self, request: PresentRequest) -> Presented:
        """Replace the object on the table. Raises: ConfigError: unknown object, or a name for a filled table."""
        world = self._world
        if world.station.sim.clutter == 0:
            name = request.object or name_in_order(world.names, request.seed, request.cycle)
            world.present(name, request.seed * 100_003 + request.cycle)
        elif request.object is not None:
            raise ConfigError(f"The table was filled at the start: {request.object!r} is not presented.", _ADVICE)
        return self.truth()

    def truth(self) -> Presented:
        """Return every object's name and true pose, and the names of those that can be presented."""
        world = self._world
        with world.lock:
            return Presented(
                objects=tuple(
                    PresentedObject(name=name, base_from_object=world.base_from_object(body))
                    for body, name in world.objects.items()
                ),
                names=world.names,
            )


def open_devices(station: Station) -> Devices:
    """Make one world and the four devices that share it; entry point of the driver registry."""
    world = World(station)
    return Devices(SimCamera(world), SimArm(world), SimHand(world), SimPresenter(world))
