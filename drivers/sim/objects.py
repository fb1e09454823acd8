"""What can lie on the table: the paper's five objects, built from primitives, or any folder of MJCF objects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from bus.errors import ConfigError

OBJECT = "object"
"""Name of the free body, and prefix of everything that belongs to it."""

_FRICTION = (0.6, 0.005, 0.0005)
_CONTACT_GROUP = 3  # where MJCF objects put their convex contact parts, beside a mesh to look at
_Rgba = tuple[float, float, float, float]


class _Builder:
    """Adds primitives to one body; densities are chosen so that the whole weighs what the real thing does."""

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
        """One primitive; ``axis`` is where its z axis points, ``heading_rad`` turns it about z."""
        geom = self._body.add_geom(type=kind, pos=pos, rgba=rgba, mass=mass_kg)
        geom.size[: len(size)] = size
        geom.friction, geom.condim = _FRICTION, 4
        if axis is not None:
            quaternion = np.zeros(4)
            mujoco.mju_quatZ2Vec(quaternion, np.asarray(axis, dtype=float))
            geom.quat = quaternion
        elif heading_rad:
            geom.quat = (np.cos(heading_rad / 2), 0.0, 0.0, np.sin(heading_rad / 2))


_BOX, _CYLINDER, _CAPSULE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE


def _bottle(build: _Builder) -> None:
    """A 0.5 l bottle, lying: body, shoulder, neck and cap along x. 0.30 kg."""
    green, cap = (0.18, 0.55, 0.30, 1.0), (0.85, 0.85, 0.82, 1.0)
    along = (1.0, 0.0, 0.0)
    build.add(_CYLINDER, (0.030, 0.065), (0.0, 0.0, 0.0), green, 0.26, axis=along)
    build.add(_CYLINDER, (0.022, 0.012), (0.077, 0.0, 0.0), green, 0.02, axis=along)
    build.add(_CYLINDER, (0.013, 0.014), (0.103, 0.0, 0.0), cap, 0.01, axis=along)
    for side in (-1.0, 1.0):  # a flat label side: it lies still, as a half-full bottle does
        build.add(_BOX, (0.055, 0.010, 0.002), (0.0, 0.0, 0.0283 * side), green, 0.005)


def _cup(build: _Builder) -> None:
    """A cup, upright: a ring of staves, a floor and a handle. 66 mm wide, 85 mm high, 0.20 kg."""
    orange = (0.88, 0.42, 0.12, 1.0)
    radius, wall, height, staves = 0.0305, 0.0025, 0.085, 20
    half_stave = radius * np.tan(np.pi / staves) + 0.0006
    for index in range(staves):
        angle = 2 * np.pi * index / staves
        pos = (radius * float(np.cos(angle)), radius * float(np.sin(angle)), height / 2)
        build.add(_BOX, (wall, half_stave, height / 2), pos, orange, 0.15 / staves, heading_rad=angle)
    build.add(_CYLINDER, (radius, 0.003), (0.0, 0.0, 0.003), orange, 0.03)
    for z, reach in ((0.020, 0.012), (0.065, 0.012)):
        build.add(_CAPSULE, (0.005, reach), (radius + 0.012, 0.0, z), orange, 0.005, axis=(1.0, 0.0, 0.0))
    build.add(_CAPSULE, (0.005, 0.022), (radius + 0.024, 0.0, 0.0425), orange, 0.01, axis=(0.0, 0.0, 1.0))


def _spatula(build: _Builder) -> None:
    """A kitchen spatula, flat: grip, shaft and blade along x. 0.12 kg."""
    black, steel = (0.10, 0.10, 0.12, 1.0), (0.75, 0.76, 0.80, 1.0)
    build.add(_BOX, (0.060, 0.011, 0.009), (-0.060, 0.0, 0.0), black, 0.07)
    build.add(_BOX, (0.030, 0.006, 0.005), (0.030, 0.0, -0.002), black, 0.02)
    build.add(_BOX, (0.045, 0.032, 0.0020), (0.100, 0.0, -0.007), steel, 0.03)


def _controller(build: _Builder) -> None:
    """A VR controller, lying: a grip and the tracking ring over its head. 0.16 kg."""
    dark, ring = (0.16, 0.17, 0.21, 1.0), (0.78, 0.80, 0.84, 1.0)
    build.add(_CAPSULE, (0.019, 0.045), (-0.035, 0.0, 0.0), dark, 0.11, axis=(1.0, 0.0, 0.0))
    build.add(_BOX, (0.020, 0.020, 0.012), (0.022, 0.0, 0.0), dark, 0.02)
    radius, pieces = 0.042, 14
    half = radius * np.tan(np.pi / pieces)
    for index in range(pieces):
        angle = 2 * np.pi * index / pieces
        pos = (0.072 + radius * float(np.cos(angle)), radius * float(np.sin(angle)), 0.0)
        build.add(
            _CAPSULE, (0.006, half), pos, ring, 0.03 / pieces, axis=(-float(np.sin(angle)), float(np.cos(angle)), 0.0)
        )


def _drone(build: _Builder) -> None:
    """A small quadcopter on its feet: body, four arms, four rotor guards. 0.25 kg."""
    body, rotor = (0.82, 0.16, 0.14, 1.0), (0.12, 0.12, 0.14, 1.0)
    build.add(_BOX, (0.048, 0.022, 0.016), (0.0, 0.0, 0.026), body, 0.17)
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            tip = (0.075 * x, 0.070 * y, 0.030)
            middle = (0.055 * x, 0.042 * y, 0.030)
            build.add(_CAPSULE, (0.005, 0.034), middle, body, 0.008, axis=(0.035 * x, 0.050 * y, 0.0))
            build.add(_CYLINDER, (0.036, 0.0025), (tip[0] + 0.012 * x, tip[1] + 0.008 * y, 0.036), rotor, 0.006)
            build.add(_CAPSULE, (0.004, 0.012), (0.050 * x, 0.030 * y, 0.016), rotor, 0.004)


_PAPER_OBJECTS: dict[str, Callable[[_Builder], None]] = {
    "bottle": _bottle,
    "cup": _cup,
    "spatula": _spatula,
    "controller": _controller,
    "drone": _drone,
}


def object_names(folder: Path | None) -> tuple[str, ...]:
    """What can be presented, sorted. Raises: ConfigError for a folder without ``<name>/object.xml``."""
    if folder is None:
        return tuple(sorted(_PAPER_OBJECTS))
    names = tuple(sorted(path.parent.name for path in folder.glob("*/object.xml")))
    if not names:
        raise ConfigError(f"No object in {folder}.", "It must hold folders with an object.xml (MJCF) each.")
    return names


def add_object(spec: mujoco.MjSpec, name: str, folder: Path | None) -> None:
    """Add object ``name`` as the free body `OBJECT`. Raises: ConfigError for an unknown or unreadable one."""
    if name not in object_names(folder):
        raise ConfigError(f"Unknown object {name!r}.", f"There are: {', '.join(object_names(folder))}.")
    if folder is None:
        body = spec.worldbody.add_body(name=OBJECT)
        body.add_freejoint(name=OBJECT)
        _PAPER_OBJECTS[name](_Builder(body))
        return
    file = folder / name / "object.xml"
    try:
        part = mujoco.MjSpec.from_file(str(file.resolve()))
    except (ValueError, mujoco.FatalError) as error:
        raise ConfigError(f"Cannot read the object {file}: {error}.", "It must be a MuJoCo model.") from error
    _attach(spec, part, file)


def _attach(spec: mujoco.MjSpec, part: mujoco.MjSpec, file: Path) -> None:
    """Attach the first body of ``part``; its own joints go, it gets one free joint."""
    root = next((body for body in part.worldbody.bodies), None)
    if root is None:
        raise ConfigError(f"{file} holds no body.", "Put the object's geoms into one <body>.")
    for joint in list(root.joints):
        part.delete(joint)
    for mesh in part.meshes:
        mesh.file = str((file.parent / part.meshdir / mesh.file).resolve())
    has_contact_parts = any(geom.group == _CONTACT_GROUP for geom in root.geoms)
    for geom in root.geoms:
        geom.friction, geom.condim = _FRICTION, 4
        if has_contact_parts and geom.group != _CONTACT_GROUP:  # the part that is only to be seen
            geom.contype = geom.conaffinity = 0
            geom.density = 0.0
    root.name = OBJECT
    root.pos, root.quat = (0, 0, 0), (1, 0, 0, 0)
    attached = spec.worldbody.add_frame().attach_body(root, "", "")
    attached.add_freejoint(name=OBJECT)
