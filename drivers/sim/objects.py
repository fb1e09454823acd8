"""The objects on the table: the paper's five, built from primitives, or any folder of MJCF objects and meshes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from bus.errors import ConfigError
from config.base import is_unicode
from drivers.sim.meshes import SUFFIXES, is_mesh
from drivers.sim.mjcf import CONDIM, FRICTION, attach, require_plausible

_Rgba = tuple[float, float, float, float]


class _Builder:
    """Adds primitives to one body, with masses that sum up to the real object's weight."""

    def __init__(self, body: mujoco.MjsBody) -> None:
        self._body = body

    def add(
        self,
        kind: mujoco.mjtGeom,
        size: tuple[float, ...],
        pos: tuple[float, float, float],
        rgba: _Rgba,
        mass_kg: float,
        *,
        axis: tuple[float, float, float] | None = None,
        heading_rad: float = 0.0,
    ) -> None:
        """Add one primitive; ``axis`` is the direction of its z axis, ``heading_rad`` turns it about z.

        Without mass it is paint: visible, but without contact.
        """
        geom = self._body.add_geom(type=kind, pos=pos, rgba=rgba, mass=mass_kg)
        geom.size[: len(size)] = size
        geom.friction, geom.condim = FRICTION, CONDIM
        if mass_kg == 0:
            geom.contype = geom.conaffinity = 0
        if axis is not None:
            quaternion = np.zeros(4)
            mujoco.mju_quatZ2Vec(quaternion, np.asarray(axis, dtype=float))
            geom.quat = quaternion
        elif heading_rad:
            geom.quat = (np.cos(heading_rad / 2), 0.0, 0.0, np.sin(heading_rad / 2))


_BOX, _CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
_CAPSULE, _ELLIPSOID = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_ELLIPSOID
_X = (1.0, 0.0, 0.0)


def _bottle(build: _Builder) -> None:
    """A half-litre bottle, lying: base, label, shoulder, neck and cap along x. 60 mm thick, 0.30 kg."""
    green, label, cap = (0.12, 0.46, 0.26, 1.0), (0.88, 0.84, 0.70, 1.0), (0.75, 0.16, 0.12, 1.0)
    build.add(_CYLINDER, (0.030, 0.055), (-0.010, 0.0, 0.0), green, 0.25, axis=_X)
    build.add(_CYLINDER, (0.027, 0.003), (-0.067, 0.0, 0.0), green, 0.005, axis=_X)
    build.add(_CYLINDER, (0.0308, 0.026), (-0.014, 0.0, 0.0), label, 0.0, axis=_X)
    build.add(_CYLINDER, (0.0310, 0.004), (-0.014, 0.0, 0.0), cap, 0.0, axis=_X)
    for index in range(6):  # the shoulder, in steps of 5 mm
        radius = 0.013 + 0.017 * float(np.cos((index + 0.7) / 6 * np.pi / 2))
        build.add(_CYLINDER, (radius, 0.0025), (0.0475 + 0.005 * index, 0.0, 0.0), green, 0.002, axis=_X)
    build.add(_CYLINDER, (0.0125, 0.010), (0.084, 0.0, 0.0), green, 0.006, axis=_X)
    build.add(_CYLINDER, (0.0150, 0.008), (0.100, 0.0, 0.0), cap, 0.007, axis=_X)
    for side in (-1.0, 1.0):  # flat on the underside, or it would roll
        build.add(_BOX, (0.050, 0.004, 0.002), (-0.010, 0.0, 0.0282 * side), green, 0.010)


def _cup(build: _Builder) -> None:
    """A cup, upright: a ring of staves, a floor and a handle. 66 mm wide, 85 mm high, 0.22 kg."""
    orange, cream = (0.80, 0.34, 0.08, 1.0), (0.93, 0.86, 0.74, 1.0)
    radius, wall, height, staves = 0.0305, 0.0025, 0.085, 24
    half_stave = radius * np.tan(np.pi / staves) + 0.0006
    for index in range(staves):
        angle = 2 * np.pi * index / staves
        pos = (radius * float(np.cos(angle)), radius * float(np.sin(angle)), height / 2)
        build.add(_BOX, (wall, half_stave, height / 2), pos, orange, 0.16 / staves, heading_rad=angle)
    build.add(_CYLINDER, (radius, 0.003), (0.0, 0.0, 0.003), cream, 0.03)
    for z in (0.020, 0.065):
        build.add(_CAPSULE, (0.005, 0.010), (radius + 0.011, 0.0, z), orange, 0.006, axis=_X)
    build.add(_CAPSULE, (0.005, 0.0225), (radius + 0.021, 0.0, 0.0425), orange, 0.018, axis=(0.0, 0.0, 1.0))


def _spatula(build: _Builder) -> None:
    """A kitchen spatula, flat: grip, shaft and slotted blade along x. 230 mm long, 0.12 kg."""
    black, steel, slot = (0.09, 0.09, 0.10, 1.0), (0.58, 0.60, 0.64, 1.0), (0.20, 0.21, 0.22, 1.0)
    build.add(_BOX, (0.050, 0.010, 0.009), (-0.055, 0.0, 0.0), black, 0.065)
    for end in (-0.105, -0.005):
        build.add(_CYLINDER, (0.010, 0.009), (end, 0.0, 0.0), black, 0.005)
    build.add(_CYLINDER, (0.004, 0.0092), (-0.104, 0.0, 0.0), steel, 0.0)
    build.add(_BOX, (0.028, 0.005, 0.004), (0.026, 0.0, -0.003), steel, 0.015)
    build.add(_BOX, (0.033, 0.031, 0.0020), (0.083, 0.0, -0.007), steel, 0.030)
    for y in (-0.017, 0.0, 0.017):
        build.add(_BOX, (0.020, 0.003, 0.0021), (0.085, y, -0.007), slot, 0.0)


def _controller(build: _Builder) -> None:
    """A VR controller, lying: grip, head with stick and buttons, tracking ring. 36 mm thick, 0.16 kg."""
    dark, ring, button = (0.13, 0.14, 0.18, 1.0), (0.70, 0.72, 0.76, 1.0), (0.05, 0.05, 0.06, 1.0)
    build.add(_CAPSULE, (0.018, 0.042), (-0.042, 0.0, 0.0), dark, 0.10, axis=_X)
    build.add(_CYLINDER, (0.024, 0.010), (0.018, 0.0, 0.006), dark, 0.03)
    build.add(_CYLINDER, (0.008, 0.006), (0.020, 0.009, 0.018), ring, 0.0)
    for x, y in ((0.012, -0.010), (0.026, -0.012)):
        build.add(_CYLINDER, (0.004, 0.0015), (x, y, 0.0165), button, 0.0)
    radius, pieces = 0.042, 20
    half = radius * np.tan(np.pi / pieces)
    for index in range(pieces):
        angle = 2 * np.pi * index / pieces
        cosine, sine = float(np.cos(angle)), float(np.sin(angle))
        pos = (0.060 + radius * cosine, radius * sine, 0.002)
        build.add(_CAPSULE, (0.006, half), pos, ring, 0.03 / pieces, axis=(-sine, cosine, 0.0))


def _drone(build: _Builder) -> None:
    """A small quadcopter on its feet: body, four arms with motors and two-bladed rotors. 44 mm wide, 0.25 kg."""
    body, dark, grey = (0.72, 0.12, 0.10, 1.0), (0.10, 0.10, 0.12, 1.0), (0.24, 0.25, 0.28, 1.0)
    build.add(_BOX, (0.044, 0.022, 0.015), (0.0, 0.0, 0.027), body, 0.17)
    build.add(_ELLIPSOID, (0.038, 0.019, 0.008), (-0.004, 0.0, 0.042), dark, 0.0)
    build.add(_CYLINDER, (0.009, 0.004), (0.046, 0.0, 0.026), dark, 0.01, axis=_X)
    build.add(_CYLINDER, (0.005, 0.005), (0.046, 0.0, 0.026), grey, 0.0, axis=_X)
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            motor, outward = (0.062 * x, 0.058 * y), (0.026 * x, 0.038 * y, 0.0)
            build.add(_CAPSULE, (0.005, 0.023), (0.049 * x, 0.039 * y, 0.030), body, 0.006, axis=outward)
            build.add(_CYLINDER, (0.010, 0.010), (*motor, 0.030), grey, 0.006)
            build.add(_BOX, (0.030, 0.0045, 0.0012), (*motor, 0.042), dark, 0.002, heading_rad=0.6 * x * y)
            build.add(_CAPSULE, (0.004, 0.010), (*motor, 0.014), dark, 0.0035)


_PAPER_OBJECTS: dict[str, Callable[[_Builder], None]] = {
    "bottle": _bottle,
    "cup": _cup,
    "spatula": _spatula,
    "controller": _controller,
    "drone": _drone,
}


def object_names(folder: Path | None) -> tuple[str, ...]:
    """Return the names that can be presented, sorted.

    Raises: ConfigError for a folder without any object, and for two of one name.
    """
    if folder is None:
        return tuple(sorted(_PAPER_OBJECTS))
    names = sorted(
        [path.parent.name for path in folder.glob("*/object.xml")]
        + [path.stem for path in folder.glob("*") if is_mesh(path)]
    )
    if not names:
        raise ConfigError(
            f"No object in {folder}.",
            f"It must hold folders with an object.xml (MJCF) each, or meshes in metres ({', '.join(SUFFIXES)}).",
        )
    foreign = [name for name in names if not is_unicode(name)]
    if foreign:
        raise ConfigError(f"The name of {foreign[0]!r} in {folder} is not UTF-8.", "Rename it.")
    twice = [name for name, following in pairwise(names) if name == following]
    if twice:
        raise ConfigError(f"There are two objects {twice[0]!r} in {folder}.", "Rename or remove one of them.")
    return tuple(names)


def require_presentable(folder: Path | None, pick_region_m: tuple[float, float, float, float]) -> None:
    """Raises: ConfigError naming the file of an object that cannot lie in the pick region and be grasped.

    Args:
        pick_region_m: (x_min, x_max, y_min, y_max) in ``base``.
    """
    if folder is not None:
        for name in object_names(folder):
            require_plausible(object_file(folder, name), pick_region_m)


def name_in_order(names: tuple[str, ...], seed: int, index: int) -> str:
    """Return the ``index``-th name of a seeded order in which each comes once a round."""
    round_number, place = divmod(index, len(names))
    order = np.random.default_rng([seed % 2**64, round_number]).permutation(len(names))
    return names[int(order[place])]


def add_object(spec: mujoco.MjSpec, name: str, folder: Path | None, body_name: str) -> None:
    """Add object ``name`` as the free body ``body_name``. Raises: ConfigError for an unknown or unreadable one."""
    if name not in object_names(folder):
        raise ConfigError(f"Unknown object {name!r}.", f"There are: {', '.join(object_names(folder))}.")
    if folder is not None:
        attach(spec, object_file(folder, name), body_name)
        return
    body = spec.worldbody.add_body(name=body_name)
    body.add_freejoint(name=body_name)
    _PAPER_OBJECTS[name](_Builder(body))


def object_file(folder: Path, name: str) -> Path:
    """Return the file of an object of the folder: its object.xml, or its mesh."""
    meshes = [file for file in folder.glob("*") if file.stem == name and is_mesh(file)]
    return next(iter(meshes), folder / name / "object.xml")
