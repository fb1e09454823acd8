"""Objects with known symmetries, as unions of analytic solids, and ray casting at them. In metres."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]

_AXES: dict[str, tuple[int, tuple[int, ...]]] = {
    "box": (0, (0, 1, 2)),
    "cylinder": (2, (2,)),
    "ellipsoid": (3, ()),
    "dome": (3, (2,)),
}
"""Per kind: how many axes are round, and which are cut off flat."""
_SPIN = 36
"""Turns that stand for a continuous axis: every 10 deg."""
_BALL_STEP_DEG = 15


@dataclass(frozen=True)
class Solid:
    """One convex piece in the object's frame, less an optional convex hole.

    Attributes:
        kind: box, cylinder (along z), ellipsoid, or dome (an ellipsoid's lower half).
        half_m: (3,) half sizes; center_m: (3,); rotation: (3, 3), columns are the solid's axes.
    """

    kind: str
    half_m: Array
    center_m: Array
    rotation: Array
    hole: Solid | None = None

    def hit(self, origins: Array, directions: Array) -> Array:
        """(n,) the first t > 0 with origin + t * direction on the surface, inf = none."""
        near, far = self._interval(origins, directions)
        if self.hole is not None:
            hole_near, hole_far = self.hole._interval(origins, directions)
            near = np.where((hole_near <= near) & (near < hole_far), hole_far, near)
        return np.where((near < far) & (near > 0), near, np.inf)

    def reach_m(self, direction: Array) -> float:
        """Return how far the solid extends along a unit direction, from the object's origin."""
        e = self.rotation.T @ direction * self.half_m
        k = 2 if self.kind == "dome" and e[2] > 0 else _AXES[self.kind][0]
        flat = 0.0 if self.kind == "dome" else np.abs(e[k:]).sum()
        return float(self.center_m @ direction + np.linalg.norm(e[:k]) + flat)

    def _interval(self, origins: Array, directions: Array) -> tuple[Array, Array]:
        """Return where each ray enters and leaves; enters after it leaves = misses."""
        o = (origins - self.center_m) @ self.rotation / self.half_m
        d = directions @ self.rotation / self.half_m
        k, cut = _AXES[self.kind]
        near, far = _quadric(o[:, :k], d[:, :k]) if k else (np.full(len(o), -np.inf), np.full(len(o), np.inf))
        for axis in cut:
            slope = np.where(np.abs(d[:, axis]) < 1e-12, 1e-12, d[:, axis])
            low, high = (-1 - o[:, axis]) / slope, ((self.kind != "dome") - o[:, axis]) / slope
            near, far = np.maximum(near, np.minimum(low, high)), np.minimum(far, np.maximum(low, high))
        return near, far


@dataclass(frozen=True)
class Object:
    """A union of solids about the centre of its bounding box.

    Attributes:
        symmetries: (k, 3, 3) rotations about the origin that change nothing.
        ups: (m, 3) directions that may point up when it rests on a table.
    """

    name: str
    solids: tuple[Solid, ...]
    symmetries: Array
    ups: Array

    def cast(self, origins: Array, directions: Array) -> Array:
        """(n,) ray parameters of the first hits, inf = none."""
        return np.asarray(np.min([solid.hit(origins, directions) for solid in self.solids], axis=0))

    def reach_m(self, direction: Array) -> float:
        return max(solid.reach_m(direction) for solid in self.solids)

    @cached_property
    def half_m(self) -> Array:
        """(3,) half of the bounding box."""
        return np.array([self.reach_m(axis) for axis in np.eye(3)])


def _quadric(o: Array, d: Array) -> tuple[Array, Array]:
    """The unit circle's or sphere's interval on every ray."""
    a = np.maximum((d * d).sum(axis=1), 1e-15)
    b = (o * d).sum(axis=1)
    under = b * b - a * ((o * o).sum(axis=1) - 1)
    root = np.sqrt(np.maximum(under, 0))
    miss = under < 0
    return np.where(miss, np.inf, (-b - root) / a), np.where(miss, -np.inf, (-b + root) / a)


# --- solids, in millimetres as one reads them off a drawing -----------------------------------------------------------


def _solid(kind: str, half_mm: tuple[float, ...], at_mm: tuple[float, ...] = (0, 0, 0), axis: str = "z") -> Solid:
    """``axis``: where the solid's own z points, or x, y, z Euler angles [deg] such as ``0,45,0``."""
    turned = {"x": (0, 90, 0), "y": (-90, 0, 0), "z": (0, 0, 0)}.get(axis) or [float(part) for part in axis.split(",")]
    rotation = Rotation.from_euler("xyz", turned, degrees=True).as_matrix()
    return Solid(kind, np.array(half_mm) / 1e3, np.array(at_mm, dtype=float) / 1e3, rotation)


def _box(x: float, y: float, z: float, at: tuple[float, ...] = (0, 0, 0), turn: str = "z") -> Solid:
    """A box of full sizes."""
    return _solid("box", (x / 2, y / 2, z / 2), at, turn)


def _rod(radius: float, length: float, at: tuple[float, ...] = (0, 0, 0), axis: str = "z") -> Solid:
    return _solid("cylinder", (radius, radius, length / 2), at, axis)


def _ball(radius: float, at: tuple[float, ...] = (0, 0, 0)) -> Solid:
    return _solid("ellipsoid", (radius, radius, radius), at)


def _tube(radius: float, wall: float, length: float, at: tuple[float, ...] = (0, 0, 0), axis: str = "z") -> Solid:
    return replace(_rod(radius, length, at, axis), hole=_rod(radius - wall, 2 * length, at, axis))


def _beaker(radius: float, wall: float, height: float) -> Solid:
    """Open above, its floor as thick as its wall."""
    return replace(_rod(radius, height), hole=_rod(radius - wall, height, (0, 0, wall)))


def _capsules(points: list[tuple[float, float, float]], radius: float) -> list[Solid]:
    """A rounded polyline."""
    solids = [_ball(radius, point) for point in points]
    for a, b in itertools.pairwise(np.array(points, dtype=float)):
        along, length = (b - a) / np.linalg.norm(b - a), float(np.linalg.norm(b - a))
        rotation = Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0].as_matrix()
        solids.append(replace(_rod(radius, length, tuple((a + b) / 2)), rotation=rotation))
    return solids


# --- symmetry groups --------------------------------------------------------------------------------------------------


def _cyclic(n: int, axis: str = "z") -> Array:
    return np.asarray(Rotation.from_euler(axis, np.arange(n)[:, None] * 360 / n, degrees=True).as_matrix())


def _dihedral(n: int) -> Array:
    """About z, and half turns about axes across it."""
    return np.concatenate([_cyclic(n), _cyclic(n) @ np.diag([1.0, -1.0, -1.0])])


def _cube() -> Array:
    return np.asarray(Rotation.create_group("O").as_matrix())


def _any() -> Array:
    """Every rotation, no farther than about 12 deg from one of these."""
    turn, tip = np.arange(0, 360, _BALL_STEP_DEG), np.arange(_BALL_STEP_DEG / 2, 180, _BALL_STEP_DEG)
    angles = np.array(list(itertools.product(turn, tip, turn)), dtype=float)
    return np.concatenate([np.eye(3)[None], Rotation.from_euler("zyz", angles, degrees=True).as_matrix()])


# --- the catalogue ----------------------------------------------------------------------------------------------------


def _object(name: str, symmetries: Array, ups: str, *solids: Solid) -> Object:
    """``ups``: letters of the axes that may point up; capitals point down."""
    axes = dict(zip("xyzXYZ", np.concatenate([np.eye(3), -np.eye(3)]), strict=True))
    middle = np.array([(_reach(solids, axis) - _reach(solids, -axis)) / 2 for axis in np.eye(3)])
    moved = tuple(_moved(solid, -middle) for solid in solids)
    return Object(name, moved, symmetries, np.array([axes[up] for up in ups]))


def _reach(solids: tuple[Solid, ...], direction: Array) -> float:
    return max(solid.reach_m(direction) for solid in solids)


def _moved(solid: Solid, by_m: Array) -> Solid:
    hole = None if solid.hole is None else _moved(solid.hole, by_m)
    return replace(solid, center_m=solid.center_m + by_m, hole=hole)


def _arc(radius: float, span_deg: float, count: int) -> list[tuple[float, float, float]]:
    angles = np.radians(np.linspace(-span_deg / 2, span_deg / 2, count))
    return [(radius * float(np.sin(a)), radius * float(np.cos(a)), 0.0) for a in angles]


@cache
def catalogue() -> tuple[Object, ...]:
    """Two dozen graspable objects; sizes in millimetres."""
    one = np.eye(3)[None]
    bowl = replace(_solid("dome", (38, 38, 38)), hole=_solid("ellipsoid", (34, 34, 34)))
    handle = _capsules([(36, 0, 24), (58, 0, 18), (58, 0, -18), (36, 0, -24)], 5)
    rotors = [_rod(24, 8, (x, y, 12)) for x in (-48, 48) for y in (-48, 48)]
    horns = [_solid("ellipsoid", (20, 42, 17), (x, -24, 0), f"0,0,{turn}") for x, turn in ((-48, -20), (48, 20))]
    pad = [_box(96, 50, 26), *horns, _rod(9, 32, (-25, 8, 0)), _rod(9, 32, (30, 8, 0))]
    jaws = [_box(26, 8, 10, (94, y, 0)) for y in (-11, 11)]
    return (
        _object("box_small", _dihedral(2), "xyz", _box(60, 40, 30)),
        _object("cube", _cube(), "z", _box(45, 45, 45)),
        _object("cardbox", _dihedral(2), "xyz", _box(120, 70, 45)),
        _object("brick", _dihedral(2), "yz", _box(160, 72, 50)),
        _object("ball", _any(), "z", _ball(32)),
        _object("can", _dihedral(_SPIN), "zxy", _rod(33, 100)),
        _object(
            "bottle",
            _cyclic(_SPIN),
            "zxy",
            _rod(31, 110),
            _solid("ellipsoid", (31, 31, 30), (0, 0, 55)),
            _rod(13, 60, (0, 0, 80)),
        ),
        _object("mug", one, "z", _beaker(37, 5, 84), *handle),
        _object("cup", _cyclic(_SPIN), "zx", _beaker(30, 4, 80), _tube(32, 6, 20, (0, 0, 30))),
        _object("bowl", _cyclic(_SPIN), "z", bowl, _rod(18, 6, (0, 0, -36))),
        _object("tape", _dihedral(_SPIN), "z", _tube(36, 14, 26)),
        _object("marker", _cyclic(_SPIN), "x", _rod(9, 100), _rod(11, 40, (0, 0, 45))),
        _object(
            "spatula", _cyclic(2, "x"), "zZ", *_capsules([(-130, 0, 0), (0, 0, 0)], 10), _box(80, 60, 8, (40, 0, 0))
        ),
        _object("hammer", _cyclic(2, "x"), "zZ", _rod(12, 170, (-80, 0, 0), "x"), _box(26, 96, 28)),
        _object(
            "wrench",
            _cyclic(2, "x"),
            "z",
            _box(150, 16, 10),
            _tube(19, 8, 14, (-84, 0, 0)),
            _box(14, 32, 10, (76, 0, 0)),
            *jaws,
        ),
        _object("screwdriver", _cyclic(_SPIN), "x", _rod(15, 85), _rod(5, 100, (0, 0, 90))),
        _object(
            "drone",
            _cyclic(4),
            "z",
            _box(54, 54, 28),
            _box(140, 12, 10, turn="0,0,45"),
            _box(140, 12, 10, turn="0,0,-45"),
            *rotors,
        ),
        _object("gamepad", one, "z", *pad),
        _object("vrctrl", one, "z", *_capsules([(-100, 0, 0), (0, 0, 0)], 16), _tube(46, 7, 16, (38, 0, 8), "0,25,0")),
        _object(
            "u_shape",
            _cyclic(2, "x"),
            "z",
            _box(24, 110, 30),
            _box(80, 26, 30, (40, 42, 0)),
            _box(80, 26, 30, (40, -42, 0)),
        ),
        _object("l_shape", one, "zZ", _box(120, 32, 28), _box(32, 80, 28, (44, 40, 0))),
        _object("t_shape", _cyclic(2, "x"), "z", _box(34, 110, 30), _box(100, 30, 30, (50, 0, 0))),
        _object("banana", _cyclic(2, "y"), "z", *_capsules(_arc(85, 100, 7), 17)),
        _object(
            "spray",
            one,
            "yY",
            _rod(29, 120),
            _rod(12, 50, (0, 0, 80)),
            _box(80, 24, 26, (18, 0, 108)),
            _box(8, 16, 40, (40, 0, 84)),
        ),
    )
