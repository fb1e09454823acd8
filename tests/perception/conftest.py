"""What the simulated camera sees of the paper's objects, with and without depth noise, and where they really are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from bus.arrays import Transform
from bus.messages import Detections, Observation
from cell.capture import capture
from config.load import load_station
from config.schema import Station
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.objects import OBJECT
from drivers.sim.world import World
from perception.detector import detect
from planning.robot import Robot

OUT_OF_SIGHT_M = (0.45, 4.0, 0.5)


@dataclass(frozen=True)
class Seen:
    """One object as it lay.

    Attributes:
        observation: of the object. ``again``: the same scene once more. ``gone``: after the object was taken away.
        base_from_object: where it really is.
    """

    station: Station
    observation: Observation
    again: Observation
    gone: Observation
    base_from_object: Transform


class Table:
    """The simulated cell's table; whatever was looked at once is remembered."""

    def __init__(self) -> None:
        station = load_station(None, ["sim.seed=11"])
        self._stations = {noise: load_station(None, ["sim.seed=11", f"sim.depth_noise={noise}"]) for noise in (0, 1)}
        self._world, self._robot = World(station), Robot(station)
        self._camera, self._arm = SimCamera(self._world), SimArm(self._world)
        self._camera.connect()
        self._arm.connect()
        self._seen: dict[tuple[str, int, int], Seen] = {}
        self._found: dict[tuple[str, int, int], Detections] = {}

    def close(self) -> None:
        self._arm.close()
        self._camera.close()

    def seen(self, name: str, seed: int, noise: int) -> Seen:
        """Object ``name`` at the pose of ``seed``, through a camera with ``noise`` times the real one's noise."""
        if (name, seed, noise) not in self._seen:
            self._present(name, seed)
        return self._seen[name, seed, noise]

    def found(self, name: str, seed: int, noise: int) -> Detections:
        """What `detect` makes of it."""
        if (name, seed, noise) not in self._found:
            seen = self.seen(name, seed, noise)
            self._found[name, seed, noise] = detect(seen.observation, seen.station)
        return self._found[name, seed, noise]

    def _present(self, name: str, seed: int) -> None:
        world = self._world
        world.present(name, seed)
        base_from_object = world.base_from_object()
        there = {noise: (self._look(noise), self._look(noise)) for noise in self._stations}
        with world.lock:
            world.data.joint(OBJECT).qpos[:3] = OUT_OF_SIGHT_M
            world.tick()
        for noise, (first, again) in there.items():
            gone = self._look(noise)
            self._seen[name, seed, noise] = Seen(self._stations[noise], first, again, gone, base_from_object)

    def _look(self, noise: int) -> Observation:
        self._world.station = self._stations[noise]
        return capture(self._camera, self._arm, self._robot)


@pytest.fixture(scope="session")
def table() -> Iterator[Table]:
    """One simulated table for all tests of perception."""
    table = Table()
    yield table
    table.close()


def distance_to_line_m(point: np.ndarray, base_from_object: Transform, axis: int) -> float:
    """Horizontal distance of a point from a line along an object's axis through its origin."""
    along = base_from_object[:2, axis] / np.linalg.norm(base_from_object[:2, axis])
    across = np.array([-along[1], along[0]])
    return float(abs((point[:2] - base_from_object[:2, 3]) @ across))
