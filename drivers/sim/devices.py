"""The simulated cell as devices: what the driver registry loads under the name ``sim``."""

from __future__ import annotations

import numpy as np

from bus.commands import Presented, PresentRequest
from config.schema import Station
from drivers.interface import Devices
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.hand import SimHand
from drivers.sim.world import World


class SimFeeder:
    """Puts objects on the table: a named one, or the next of a seeded order in which each comes once a round."""

    def __init__(self, world: World) -> None:
        self._world = world

    def present(self, request: PresentRequest) -> Presented:
        names = self._world.names
        round_number, place = divmod(request.cycle, len(names))
        order = np.random.default_rng([request.seed, round_number]).permutation(len(names))
        self._world.present(request.object or names[order[place]], request.seed * 100_003 + request.cycle)
        return self.truth()

    def truth(self) -> Presented:
        return Presented(object=self._world.object_name, base_from_object=self._world.base_from_object())


def open_devices(station: Station) -> Devices:
    """One world, and the four devices that share it."""
    world = World(station)
    return Devices(SimCamera(world), SimArm(world), SimHand(world), SimFeeder(world))
