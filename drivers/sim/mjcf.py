"""Reads objects from MJCF files and meshes: makes one rigid body of each, and checks that the result can be picked."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from bus.errors import ConfigError
from drivers.sim.meshes import CONTACT_GROUP, is_mesh, mesh_object
from drivers.sim.placing import Placing

FRICTION = (0.6, 0.005, 0.0005)
"""Of objects: sliding, then torsional and rolling [m]."""
CONDIM = 6
"""Contacts of objects resist rolling, too: without it a ball never comes to rest."""

_log = logging.getLogger(__name__)
_SEEN_GROUPS = (0, 1, 2)
_VISUAL_SETTINGS = ("global_", "headlight", "map", "quality", "rgba", "scale")
_WITHOUT_USE = ("keys", "sensors", "actuators", "equalities", "tendons", "excludes", "pairs")
_NUMBERS = ("mass", "density", "size", "pos", "quat", "axisangle", "euler", "fromto", "scale", "diaginertia", "vertex")
_LIGHTEST_KG, _HEAVIEST_KG = 5e-4, 10.0
_THINNEST_M, _SMALLEST_M = 1e-4, 5e-3
_ASIDE_M = 0.1
"""Largest distance of the body's origin outside of its contact geoms, because it stands for the object's place."""
_IN_MM = 'Is the mesh in mm? Then give its <mesh> scale="0.001 0.001 0.001" in an object.xml, or save it in metres.'
_MM_FROM_M = 3.0
"""A larger object [m] was modelled in millimetres."""


def attach(spec: mujoco.MjSpec, file: Path, body_name: str, *, in_parts: bool = True) -> str:
    """Add the object of ``file`` to ``spec`` as the free body ``body_name``, with its rigidly attached children.

    Args:
        file: an MJCF, or a mesh. ``in_parts``: as `meshes.mesh_object`, of a mesh.

    Returns:
        The names of its own joints to its world, which are left out.

    Raises:
        ConfigError: the file is no MJCF and no mesh, or does not hold one rigid body.
    """
    part = mesh_object(file, in_parts=in_parts) if is_mesh(file) else _read(file)
    root = _only_body(part, file)
    bound = _make_rigid(part, root, file)
    for mesh in part.meshes:
        mesh.file = str((file.parent / part.meshdir / mesh.file).resolve()) if mesh.file else ""
    for texture in part.textures:
        texture.file = str((file.parent / part.texturedir / texture.file).resolve()) if texture.file else ""
    _make_touchable(root)
    root.pos, root.quat = (0, 0, 0), (1, 0, 0, 0)
    _adopt(part.option, spec.option)
    for name in _VISUAL_SETTINGS:
        _adopt(getattr(part.visual, name), getattr(spec.visual, name))
    part.memory = spec.memory
    try:
        attached = spec.worldbody.add_frame().attach_body(root, f"{body_name}_", "")
    except (ValueError, mujoco.FatalError) as error:
        raise _unusable(file, error) from error
    attached.name = body_name
    attached.add_freejoint(name=body_name)
    return bound


def require_plausible(file: Path, pick_region_m: tuple[float, float, float, float]) -> None:
    """Compile the object alone and check the result.

    Args:
        pick_region_m: (x_min, x_max, y_min, y_max) in ``base``.

    Raises:
        ConfigError: names the file: it does not compile, or cannot be picked.
    """
    spec = mujoco.MjSpec()
    bound = attach(spec, file, "object", in_parts=False)
    if bound:
        _log.warning("%s: the object is free, its joints are left out: %s", file, bound)
    try:
        model: mujoco.MjModel = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise _unusable(file, error) from error
    wrong = _what_is_wrong(model, pick_region_m)
    if wrong is not None:
        raise ConfigError(f"The object {file} {wrong[0]}.", wrong[1])


def _what_is_wrong(model: mujoco.MjModel, pick_region_m: tuple[float, float, float, float]) -> tuple[str, str] | None:
    """Return what is impossible about the compiled object, and the advice; None when nothing is."""
    if not model.geom_contype.any():
        return "has nothing that can be touched", "Give a geom of its body contype and conaffinity 1 (the default)."
    if not np.isin(model.geom_group[model.geom_rgba[:, 3] > 0], _SEEN_GROUPS).any():
        return "has nothing that can be seen", "Put a geom of it into group 0, 1 or 2, and let it not be transparent."
    mass_kg = float(model.body("object").subtreemass[0])
    if not _LIGHTEST_KG <= mass_kg <= _HEAVIEST_KG:
        # a mesh too large weighs tons, so its size comes first
        return _wrong_size(model, pick_region_m) or (
            f"weighs {mass_kg:.3g} kg",
            f"Give its geoms a mass or density that makes {_LIGHTEST_KG} to {_HEAVIEST_KG:.0f} kg.",
        )
    return _wrong_size(model, pick_region_m)


def _wrong_size(model: mujoco.MjModel, pick_region_m: tuple[float, float, float, float]) -> tuple[str, str] | None:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low, high = Placing(model, data, pick_region_m).extent()
    if not (np.isfinite([low, high]).all() and np.isfinite(model.body_inertia).all()):
        return "has a number that is not finite", "Look for nan and inf in it."
    side_m = high - low
    in_words = " x ".join(f"{length:.3g}" for length in side_m)
    x_min, x_max, y_min, y_max = pick_region_m
    if side_m.max() > math.hypot(x_max - x_min, y_max - y_min):
        advice = _IN_MM if side_m.max() > _MM_FROM_M else "Take it out of the folder, or enlarge scene.pick_region_m."
        return f"is {in_words} m large and does not fit into the pick region", advice
    if side_m.max() < _SMALLEST_M or side_m.min() < _THINNEST_M:
        return f"is {in_words} m small", "Is the scale of its <mesh> right? Objects are in metres."
    if (low > _ASIDE_M).any() or (high < -_ASIDE_M).any():
        return "lies far from the origin of its body", f"Shift its geoms to within {_ASIDE_M} m of it."
    return None


# --- reading ----------------------------------------------------------------------------------------------------------


def _read(file: Path) -> mujoco.MjSpec:
    """Read the file. Raises: ConfigError."""
    try:
        text = file.read_bytes().decode()
        _require_finite(text, file)
        return mujoco.MjSpec.from_file(str(file.resolve()))
    except UnicodeDecodeError as error:
        raise ConfigError(f"The object {file} is not UTF-8 text.", "Save it as UTF-8 in your editor.") from error
    except (OSError, ValueError, mujoco.FatalError) as error:
        raise _unusable(file, error) from error


def _require_finite(text: str, file: Path) -> None:
    """Raises: ConfigError for a number that is not finite, because MuJoCo takes ``mass="nan"`` for no mass at all."""
    try:
        elements = list(ElementTree.fromstring(text.removeprefix("\ufeff").encode()).iter())
    except ElementTree.ParseError:
        return  # MuJoCo reports the error
    for element in elements:
        for key in _NUMBERS:
            if any(word in element.get(key, "").lower() for word in ("nan", "inf")):
                raise ConfigError(
                    f'The object {file} has {key}="{element.get(key)}" in a <{element.tag}>.', "Give a finite number."
                )


def _unusable(file: Path, error: Exception) -> ConfigError:
    """Return the error with MuJoCo's text on one line."""
    words = " ".join(str(error).split()).removeprefix("Error: ").rstrip(".")
    return ConfigError(f"Cannot read the object {file}: {words}.", "It must be a MuJoCo model that compiles.")


def _only_body(part: mujoco.MjSpec, file: Path) -> mujoco.MjsBody:
    """Return the one body that has geoms. Raises: ConfigError when there is another number of them."""
    bodies = [body for body in part.worldbody.bodies if any(_geoms(body))]
    if len(bodies) > 1:
        names = ", ".join(repr(body.name) for body in bodies)
        raise ConfigError(
            f"{file} holds {len(bodies)} bodies: {names}.",
            "An object is one: put them into one <body>, or each into a folder of its own.",
        )
    loose = [geom for geom in part.worldbody.geoms if geom.type != mujoco.mjtGeom.mjGEOM_PLANE]  # a floor is ignored
    if loose or not bodies:
        what = f"holds {len(loose)} geoms outside of a body" if loose else "holds no body with a geom"
        raise ConfigError(f"{file} {what}.", "Put the object's geoms into one <body>.")
    return bodies[0]


def _parts(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    """Yield the body and all its descendants."""
    yield body
    for child in body.bodies:
        yield from _parts(child)


def _geoms(body: mujoco.MjsBody) -> Iterator[mujoco.MjsGeom]:
    return (geom for one in _parts(body) for geom in one.geoms)


def _make_rigid(part: mujoco.MjSpec, root: mujoco.MjsBody, file: Path) -> str:
    """Delete the body's own joints (it gets one free joint), and everything that drives or measures them.

    Returns: the names of those that are not free.

    Raises: ConfigError for joints within it.
    """
    inner = [joint for child in root.bodies for body in _parts(child) for joint in body.joints]
    if inner:
        raise ConfigError(f"{file} has joints within it: {_names(inner)}.", "An object is rigid: take them out.")
    if part.compiler.settotalmass > 0:
        raise ConfigError(f"{file} sets its total mass (settotalmass).", "Give its geoms their mass instead.")
    bound = _names([joint for joint in root.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE])
    root.mocap = False
    for kind in _WITHOUT_USE:  # before the joints, which they refer to
        for one in list(getattr(part, kind)):
            part.delete(one)
    for joint in list(root.joints):
        part.delete(joint)
    return bound


def _names(joints: Sequence[mujoco.MjsJoint]) -> str:
    return ", ".join(joint.name or "one without a name" for joint in joints)


def _make_touchable(root: mujoco.MjsBody) -> None:
    """Set the friction that grasps were measured with; where there are contact parts, other geoms are only visual."""
    has_contact_parts = any(geom.group == CONTACT_GROUP for geom in _geoms(root))
    for geom in _geoms(root):
        geom.friction, geom.condim = FRICTION, CONDIM
        if has_contact_parts and geom.group != CONTACT_GROUP:
            geom.contype = geom.conaffinity = 0
            geom.density = 0.0
        elif geom.contype or geom.conaffinity:  # here it collides with everything, whatever its own masks say
            geom.contype = geom.conaffinity = 1


def _adopt(its: object, ours: object) -> None:
    """Replace the object file's world-wide settings by ours, because MuJoCo warns of conflicts."""
    for field in dir(ours):
        if not field.startswith("_"):
            setattr(its, field, getattr(ours, field))
