"""The simulated cell's node in a process of its own, as the product has it; it also notes what its devices did.

The notes come over a pipe: when each deed began and ended, how much simulated time it took, and where every object then
was. They are read from the world itself, which no part of the cell can change afterwards.
"""

from __future__ import annotations

import multiprocessing as mp
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from benchmarks.held.solids import Thing, things
from bus.commands import Presented, PresentRequest
from bus.errors import CellError, CellUnreachable, ConfigError
from bus.messages import Frame, HandState, Motion
from bus.trajectory import Trajectory
from cell.nodes.process import limit_malloc_arenas
from config.schema import Station
from drivers.interface import Devices
from drivers.node.link import join_cell
from drivers.node.node import Node
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.devices import SimPresenter
from drivers.sim.hand import SimHand
from drivers.sim.placing import Placing, park
from drivers.sim.world import World

NODE = "sim"
PRESENT, CAPTURE, ARM, HOLD, HAND, GRASP = "present", "capture", "arm", "hold", "hand", "grasp"
"""Kinds of deeds; a hold is a motion of the arm that does not move."""
_TAKE, _FREE = "take", "free"
_START_S, _END_S = 300.0, 30.0

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Deed:
    """One action of one device.

    Attributes:
        kind: one of the above.
        began_s, ended_s: monotonic clock of this machine.
        from_s, to_s: simulated time; it starts anew with every object presented.
        height_m: (n,) of every object's centre of mass, after it. ``touching``: (n,) whether it touches the robot then.
        base_from_body: (n, 4, 4) of every object's body, after it.
    """

    kind: str
    began_s: float
    ended_s: float
    from_s: float
    to_s: float
    height_m: Array
    touching: npt.NDArray[np.bool_]
    base_from_body: Array


@dataclass(frozen=True)
class Notes:
    """The deeds since the notes were last asked for, and the objects that lie there now."""

    deeds: tuple[Deed, ...]
    things: tuple[Thing, ...]


class Watch:
    """Notes the deeds in one world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._deeds: list[Deed] = []
        self._turn = threading.Lock()

    @contextmanager
    def deed(self, kind: str) -> Iterator[None]:
        """Note what is done meanwhile, however it ends."""
        began_s, from_s = time.monotonic(), self._now_s()
        try:
            yield
        finally:
            ended_s, to_s = time.monotonic(), self._now_s()
            with self._turn:
                self._deeds.append(Deed(kind, began_s, ended_s, from_s, to_s, *self._where()))

    def take(self) -> Notes:
        """Return the deeds since the last time."""
        with self._turn:
            deeds, self._deeds = tuple(self._deeds), []
        with self._world.lock:
            return Notes(deeds, things(self._world.model, self._world.objects))

    def free_the_arm(self) -> int:
        """Take away every object that touches the robot, as a person does after an abort; return their number."""
        world = self._world
        with world.turns.taken(), world.lock:
            bodies = [body for body, is_touching in zip(world.objects, self._touching(), strict=True) if is_touching]
            region_m = world.station.scene.pick_region_m
            park([Placing(world.model, world.data, region_m, body) for body in bodies])
        return len(bodies)

    def _touching(self) -> list[bool]:
        """Return which objects touch the robot; the caller holds the lock."""
        model = self._world.model
        robot = model.body("base").id
        pairs = [model.body_rootid[model.geom_bodyid[contact.geom]].tolist() for contact in self._world.data.contact]
        touching = {body for pair in pairs if robot in pair for body in pair}
        return [model.body(body).id in touching for body in self._world.objects]

    def _now_s(self) -> float:
        with self._world.lock:
            return float(self._world.data.time)

    def _where(self) -> tuple[Array, npt.NDArray[np.bool_], Array]:
        with self._world.lock:
            touching = self._touching()  # by the contacts of the last tick
            mujoco.mj_kinematics(self._world.model, self._world.data)
            mujoco.mj_comPos(self._world.model, self._world.data)
            height_m = [self._world.data.body(body).xipos[2] for body in self._world.objects]
            poses = [self._world.base_from_object(body) for body in self._world.objects]
        return np.array(height_m), np.array(touching), np.array(poses).reshape(-1, 4, 4)


# --- the devices ------------------------------------------------------------------------------------------------------


class _Camera(SimCamera):
    def __init__(self, world: World, watch: Watch) -> None:
        super().__init__(world)
        self._watch = watch

    def capture(self) -> Frame:
        with self._watch.deed(CAPTURE):
            return super().capture()


class _Arm(SimArm):
    def __init__(self, world: World, watch: Watch) -> None:
        super().__init__(world)
        self._watch = watch

    def execute(self, trajectory: Trajectory) -> Motion:
        is_still = float(np.ptp(trajectory.raw_q_rad, axis=0).max()) == 0.0
        with self._watch.deed(HOLD if is_still else ARM):
            return super().execute(trajectory)


class _Hand(SimHand):
    def __init__(self, world: World, watch: Watch) -> None:
        super().__init__(world)
        self._watch = watch

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        with self._watch.deed(HAND):
            return super().move(width_m, speed_m_s)

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        with self._watch.deed(GRASP):
            return super().grasp(force_n, speed_m_s)


class _Presenter(SimPresenter):
    def __init__(self, world: World, watch: Watch) -> None:
        super().__init__(world)
        self._watch = watch

    def present(self, request: PresentRequest) -> Presented:
        with self._watch.deed(PRESENT):
            return super().present(request)


def _serve(station: Station, pipe: Connection) -> None:
    """Serve the node until the other side closes its pipe."""
    limit_malloc_arenas()
    try:
        world = World(station)
        watch = Watch(world)
        devices = Devices(_Camera(world, watch), _Arm(world, watch), _Hand(world, watch), _Presenter(world, watch))
        with join_cell(station) as bus:
            node = Node(NODE, bus, devices, station)
            node.open()
            pipe.send(None)
            _answer(pipe, watch)
            node.close()
    except CellError as error:
        pipe.send((error.text, error.advice))
    os._exit(0)  # immediately: a thread inside MuJoCo would abort the interpreter


def _answer(pipe: Connection, watch: Watch) -> None:
    while True:
        try:
            asked = pipe.recv()
            pipe.send(watch.take() if asked == _TAKE else watch.free_the_arm())
        except (EOFError, OSError):
            return


# --- the benchmark's side ---------------------------------------------------------------------------------------------


class Watched:
    """The benchmark's end of the pipe, where it reads the notes."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def take(self) -> Notes:
        """Return the deeds since the last time. Raises: CellUnreachable when the node's process has ended."""
        notes: Notes = self._ask(_TAKE)
        return notes

    def free_the_arm(self) -> int:
        """As `Watch.free_the_arm`. Raises: as `take`."""
        number: int = self._ask(_FREE)
        return number

    def _ask(self, what: str) -> Any:
        try:
            self._pipe.send(what)
            return self._pipe.recv()
        except (EOFError, OSError) as error:
            raise CellUnreachable("The simulated node has ended.", "See its own message above.") from error


@contextmanager
def watched_node(station: Station) -> Iterator[Watched]:
    """The node, in the cell of ``station`` that already runs. Raises: ConfigError, CellUnreachable."""
    context = mp.get_context("spawn")  # zenoh does not survive a fork
    ours, its = context.Pipe()
    process = context.Process(target=_serve, args=(station, its), daemon=True)
    process.start()
    its.close()
    try:
        _await_ready(ours)
        yield Watched(ours)
    finally:
        ours.close()
        process.join(_END_S)
        process.kill()


def _await_ready(pipe: Connection) -> None:
    try:
        refusal = pipe.recv() if pipe.poll(_START_S) else ("It does not answer.", "See its own message above.")
    except EOFError:
        refusal = ("It ended.", "See its own message above.")
    if refusal is not None:
        text, advice = refusal
        raise ConfigError(f"The simulated node does not start: {text}", advice)
