"""An object at rest on a table before a camera, a rod that a jaw could close along, and depth images of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.shapes import Object, catalogue
from bus.messages import CameraModel
from bus.transforms import affine, apply, inverse
from perception.align.base import Array, Mask
from perception.geometry.lift import lift_pixels, project

CAMERA = CameraModel(width=640, height=576, fx=504.0, fy=504.0, cx=319.5, cy=287.5)

_CAMERA_DISTANCE_M = (0.50, 0.65)
_MAX_TILT_DEG = 30.0
_OFF_CENTER_M = 0.03
_ROD_RADIUS_M, _ROD_STICKS_OUT_M, _ROD_CLEARANCE_M = 0.005, 0.035, 0.001
_JAW_M, _THINNEST_M = 0.078, 0.004
_MAX_FRICTION_DEG, _MAX_ROD_TILT_DEG, _MAX_OFF_IMAGE_DEG = 20.0, 12.0, 25.0
_ROD_TRIES, _POSE_TRIES = 600, 8
_NORMAL_STEP_M = 0.0025
"""Beside and above the contact, so a rod does not run along an object's very top."""
_FAR_M = 3.0


@dataclass(frozen=True)
class Scene:
    """An object at rest on a table in front of the camera; the transforms are rigid."""

    object: Object
    world_from_object: Array
    camera_from_world: Array
    rod_ends: Array

    @property
    def camera_from_object(self) -> Array:
        return np.asarray(self.camera_from_world @ self.world_from_object)


@dataclass(frozen=True)
class Picture:
    """z-depth of everything, and what is seen where."""

    depth_m: Array
    object: Mask
    rod: Mask


# --- the scene --------------------------------------------------------------------------------------------------------


def scenes(count: int, seed: int) -> Iterator[tuple[Scene, np.random.Generator]]:
    """``count`` seeded scenes, object after object, each with its own generator for what follows."""
    made, index = 0, 0
    while made < count:
        rng = np.random.default_rng([seed, index])
        scene = scene_of(catalogue()[index % len(catalogue())], rng)
        index += 1
        if scene is not None:
            made += 1
            yield scene, rng


def scene_of(item: Object, rng: np.random.Generator) -> Scene | None:
    """A resting pose, a camera and a rod that could be grasped along; None when no rod was found."""
    for _ in range(_POSE_TRIES):
        up = item.ups[rng.integers(len(item.ups))]
        yaw = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
        turn = (yaw * Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]).as_matrix()
        pose = affine(turn, np.array([0.0, 0.0, item.reach_m(-up)]))
        camera_from_world = _camera(float(pose[2, 3]), rng)
        ends = _rod(item, pose, camera_from_world, rng)
        if ends is not None:
            return Scene(item, pose, camera_from_world, ends)
    return None


def _camera(height_m: float, rng: np.random.Generator) -> Array:
    """camera_from_world of a camera that looks roughly at the object."""
    tilt = np.radians(rng.uniform(0, _MAX_TILT_DEG))
    world_from_camera = Rotation.from_euler("x", np.pi + tilt).as_matrix()
    target = np.append(rng.uniform(-_OFF_CENTER_M, _OFF_CENTER_M, 2), height_m)
    position = target - rng.uniform(*_CAMERA_DISTANCE_M) * world_from_camera[:, 2]
    return affine(world_from_camera.T, -world_from_camera.T @ position)


def _rod(item: Object, pose: Array, camera_from_world: Array, rng: np.random.Generator) -> Array | None:
    """Ends (2, 3) in the object's frame of a line a jaw could close along, its middle between the two contacts."""
    span = item.half_m.max() + 0.05
    yaw, rise = rng.uniform(0, 2 * np.pi, _ROD_TRIES), np.radians(rng.normal(0, _MAX_ROD_TILT_DEG / 2, _ROD_TRIES))
    along = np.stack([np.cos(yaw) * np.cos(rise), np.sin(yaw) * np.cos(rise), np.sin(rise)], axis=1)
    through = apply(pose, rng.uniform(-1, 1, (_ROD_TRIES, 3)) * item.half_m)
    first, first_flat = _contact(item, pose, through - 2 * span * along, along)
    last, last_flat = _contact(item, pose, through + 2 * span * along, -along)
    width = 4 * span - first - last
    middle = through + ((first - last) / 2)[:, None] * along
    half = width / 2 + _ROD_STICKS_OUT_M
    low = middle[:, 2] - half * np.abs(along[:, 2]) - _ROD_RADIUS_M
    off_image = np.abs(along @ camera_from_world[2, :3])
    good = first_flat & last_flat & (width > _THINNEST_M) & (width < _JAW_M) & (low > _ROD_CLEARANCE_M)
    good &= (off_image < np.sin(np.radians(_MAX_OFF_IMAGE_DEG))) & (np.abs(rise) < np.radians(_MAX_ROD_TILT_DEG))
    if not good.any():
        return None
    k = int(good.argmax())
    ends = middle[k] + np.outer([-half[k], half[k]], along[k])
    return apply(inverse(pose), ends)


def _contact(item: Object, pose: Array, origins: Array, along: Array) -> tuple[Array, Mask]:
    """Distance to the surface, and whether it faces the ray closely enough: two more rays beside it give the slope."""
    side = np.cross(along, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    starts = [origins, origins + _NORMAL_STEP_M * side, origins + _NORMAL_STEP_M * np.cross(side, along)]
    turn = pose[:3, :3]
    t = item.cast((np.concatenate(starts) - pose[:3, 3]) @ turn, np.tile(along @ turn, (3, 1))).reshape(3, -1)
    hit = np.isfinite(t).all(axis=0)
    t = np.where(hit, t, 0.0)
    slope = np.hypot(t[1] - t[0], t[2] - t[0]) / _NORMAL_STEP_M
    return t[0], hit & (slope < np.tan(np.radians(_MAX_FRICTION_DEG)))


# --- pictures ---------------------------------------------------------------------------------------------------------


def render(scene: Scene, camera_from_object: Array, rod: Array | None) -> Picture:
    """Rays are cast in the object's frame, where a stretched object is itself; ``rod``: ends (2, 3) in the camera."""
    rows, columns = _window(scene, camera_from_object)
    v, u = np.mgrid[rows, columns]
    directions = lift_pixels(np.stack([u.ravel(), v.ravel()], axis=1).astype(float), np.ones(u.size), CAMERA)
    object_from_camera = np.linalg.inv(camera_from_object)
    origins = np.tile(object_from_camera[:3, 3], (len(directions), 1))
    inner = directions @ object_from_camera[:3, :3].T
    body = scene.object.cast(origins, inner)
    normal, height = scene.world_from_object[2, :3], scene.world_from_object[2, 3]
    table = -(origins @ normal + height) / np.minimum(inner @ normal, -1e-9)
    stick = np.full(len(body), np.inf) if rod is None else _stick(rod, directions)
    depth = np.minimum(np.minimum(body, stick), np.clip(table, 0, _FAR_M))
    full = [np.full((CAMERA.height, CAMERA.width), empty) for empty in (np.nan, False, False)]
    for image, part in zip(full, (depth, (body <= stick) & (body < np.inf), stick < body), strict=True):
        image[rows, columns] = part.reshape(u.shape)
    return Picture(full[0], full[1].astype(bool), full[2].astype(bool))


def _stick(ends: Array, directions: Array) -> Array:
    """z-depth of a rod given by its ends in the camera frame."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.cross(along, directions)
    offset = np.cross(along, -ends[0])
    a, b = (across**2).sum(axis=1), across @ offset
    root = b * b - a * (offset @ offset - _ROD_RADIUS_M**2)
    z = (-b - np.sqrt(np.maximum(root, 0))) / a
    s = (z[:, None] * directions - ends[0]) @ along
    inside = (root > 0) & (s >= 0) & (s <= np.linalg.norm(ends[1] - ends[0]))
    return np.where(inside, z, np.inf)


def _window(scene: Scene, camera_from_object: Array, margin_px: int = 12) -> tuple[slice, slice]:
    """Rows and columns that hold the object, its rod and some table."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = np.concatenate([signs * scene.object.half_m, scene.rod_ends])
    pixels = project(apply(camera_from_object, corners), CAMERA)
    low, high = np.floor(pixels.min(axis=0)).astype(int), np.ceil(pixels.max(axis=0)).astype(int)
    low, high = np.maximum(low - margin_px, 0), np.minimum(high + margin_px + 1, [CAMERA.width, CAMERA.height])
    return slice(low[1], high[1]), slice(low[0], high[0])
