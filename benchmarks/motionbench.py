"""MotionBenchMaker's problems for the Panda, for the FR3: the shapes of a scene, a start and a goal configuration.

Chamzas et al., "MotionBenchMaker: A Tool to Generate and Benchmark Motion Planning Datasets", RA-L 2022. The two arms
have the same links, but other limits, and this hand carries a camera: part of the problems is none for this arm.
"""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import coal
import numpy as np

from bus.arrays import Joints, Transform
from bus.lazy import LazyModule
from bus.transforms import from_wxyz
from config.limits import outside, velocity_bounds
from planning.robot import Robot
from planning.scene import Scene
from planning.world import Thing

yaml: Any = LazyModule("yaml")

_JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))


@dataclass(frozen=True)
class Problem:
    """One problem.

    Attributes:
        name: set and number, like ``cage_panda/0007``.
        scene_yaml, request_yaml: its two files.
    """

    name: str
    scene_yaml: bytes
    request_yaml: bytes

    @cached_property
    def obstacles(self) -> tuple[Thing, ...]:
        """Everything that stands around the arm."""
        objects = _loaded(self.scene_yaml)["world"]["collision_objects"]
        return tuple(
            Thing(str(one["id"]), _shape(primitive), _pose(pose))
            for one in objects
            for primitive, pose in zip(one["primitives"], one["primitive_poses"], strict=True)
        )

    @cached_property
    def ends_rad(self) -> tuple[Joints, Joints]:
        """Start and goal, each (7,)."""
        request = _loaded(self.request_yaml)
        state = request["start_state"]["joint_state"]
        start = dict(zip(state["name"], state["position"], strict=True))
        (goal,) = request["goal_constraints"]
        to = {one["joint_name"]: one["position"] for one in goal["joint_constraints"]}
        return tuple(np.array([float(q[joint]) for joint in _JOINTS]) for q in (start, to))  # type: ignore[return-value]

    def scene(self, robot: Robot) -> Scene:
        """Return what the planner is given: no box of a station, the obstacles as they are."""
        return Scene(robot, robot.station, (), fixed=self.obstacles)

    def is_within_limits(self) -> bool:
        """Whether this arm's joints reach start and goal."""
        return outside(np.stack(self.ends_rad)) is None

    def is_free(self, scene: Scene) -> bool:
        """Whether start and goal keep the planner's clearance with an open hand."""
        return all(scene.collision(q, scene.station.hand.max_width_m) is None for q in self.ends_rad)

    def may_move_at_ends(self) -> bool:
        """Whether some speed is allowed at start and goal, both ways, of every joint."""
        lower, upper = velocity_bounds(np.stack(self.ends_rad))
        return bool((lower < 0).all() and (upper > 0).all())


def problems(path: Path, every: int, offset: int) -> Iterator[Problem]:
    """Yield every ``every``-th problem of the archive from the ``offset``-th on, in the order of their names.

    Raises:
        ValueError: a request has no scene.
    """
    with tarfile.open(path) as archive:
        files = {member.name: member for member in archive.getmembers() if member.name.endswith(".yaml")}
        requests = sorted(name for name in files if Path(name).name.startswith("request"))
        for name in requests[offset::every]:
            number = Path(name).stem.removeprefix("request")
            folder = Path(name).parent
            scene = str(folder / f"scene{number}.yaml")
            if scene not in files:
                raise ValueError(f"{path} has {name}, but not {scene}")
            yield Problem(f"{folder.name}/{number}", *(_read(archive, files[one]) for one in (scene, name)))


def _read(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    file = archive.extractfile(member)
    assert file is not None, member.name
    return file.read()


def _loaded(text: bytes) -> Any:
    return yaml.load(text, Loader=yaml.CSafeLoader)


def _shape(primitive: dict[str, Any]) -> coal.CollisionGeometry:
    """ROS' ``SolidPrimitive``: a box has its sizes, a cylinder height and radius."""
    match primitive["type"]:
        case "box":
            return coal.Box(*map(float, primitive["dimensions"]))
        case "cylinder":
            height_m, radius_m = map(float, primitive["dimensions"])
            return coal.Cylinder(radius_m, height_m)
        case other:
            raise ValueError(f"a primitive of the type {other!r} is not known here")


def _pose(pose: dict[str, Any]) -> Transform:
    x, y, z, w = map(float, pose["orientation"])
    return from_wxyz((w, x, y, z), tuple(map(float, pose["position"])))
