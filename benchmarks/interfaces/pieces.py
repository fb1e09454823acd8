"""Pieces of which two come along with one grasp: touching blocks, a block on a block, a cup in a cup, linked rings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bus.codes import Code
from bus.errors import CycleFailure
from bus.transforms import from_rotation
from config.franka_hand import FINGER_TIP_M
from drivers.sim.placing import Placing
from drivers.sim.world import World

KINDS = ("touching", "touching_alike", "stacked", "stacked_alike", "nested", "linked", "binned")
"""``alike``: two equal pieces of one colour, as a line counts them. Nested cups are equal and of one colour, linked
rings equal and of two; what only touches or is stacked differs in colour and size. ``binned``: two unlike blocks, 8 to
14 mm apart, so that the camera may tell them apart, among other things in a bin."""
NAMES = ("first", "second")
_DENSITY_KG_M3 = 700.0
_SETTLE_TICKS = 500
_STAVES, _PIECES = 20, 14
_RING_M, _TUBE_M = 0.024, 0.004
_CUP_M, _BOTTOM_M, _RIM_M, _WALL_M = 0.060, 0.020, 0.029, 0.0015
_APART_M, _DRAWS = 0.07, 60
"""From the middle of a pair in a bin to other things; and how often a place for it is drawn."""
_LOWEST_M = 0.004
"""Of the finger tips above the table."""

Array = npt.NDArray[np.float64]
Size = tuple[float, float, float]


@dataclass(frozen=True)
class Pair:
    """Two pieces and how they lie.

    Attributes:
        kind: one of `KINDS`. ``sizes_m``: of the two blocks; of cups and rings, the boxes around them.
        xml: the MJCF of each.
    """

    kind: str
    sizes_m: tuple[Size, Size]
    xml: tuple[str, str]

    def write(self, folder: Path) -> None:
        """Write both as objects of a folder."""
        for name, text in zip(NAMES, self.xml, strict=True):
            (folder / name).mkdir(parents=True)
            (folder / name / "object.xml").write_text(text)


@dataclass(frozen=True)
class Jaw:
    """A closing of the fingers: ``base_from_tcp`` (4, 4), and the width [m] of what is between them there."""

    base_from_tcp: Array
    width_m: float


def drawn(kind: str, rng: np.random.Generator) -> Pair:
    """Draw a pair of a kind."""
    colors = _colors(rng, is_alike=kind.endswith("alike") or kind == "nested")
    if kind == "nested":
        around = (2 * _RIM_M, 2 * _RIM_M, _CUP_M)
        return Pair(kind, (around, around), (_cup(colors[0]), _cup(colors[1])))
    if kind == "linked":
        side = 2 * (_RING_M + _TUBE_M)
        around = (side, side, 2 * _TUBE_M)
        return Pair(kind, (around, around), (_ring(colors[0]), _ring(colors[1])))
    sizes = _stack(rng) if kind.startswith("stacked") else _side_by_side(rng, 0.030 if kind == "binned" else 0.035)
    if kind.endswith("alike"):
        sizes = sizes[0], sizes[0]
    return Pair(kind, sizes, (_block(sizes[0], colors[0]), _block(sizes[1], colors[1])))


def lay(pair: Pair, world: World, rng: np.random.Generator) -> Jaw:
    """Lay the pair into the pick region, let it come to rest, and return the jaw that takes both."""
    bodies = {name: body for body, name in world.objects.items()}
    first, second = (Placing(world.model, world.data, world.station.scene.pick_region_m, bodies[n]) for n in NAMES)
    middle_m = _free_place(world, first.region(), rng)
    heading = float(rng.uniform(-1.2, 1.2))
    across = np.array([np.cos(heading), np.sin(heading), 0.0])
    poses = _POSES[pair.kind.removesuffix("_alike")](pair, rng)
    with world.turns.taken():
        with world.lock:
            for placing, (offset_m, turn) in zip((first, second), poses, strict=True):
                turned = Rotation.from_euler("z", heading) * turn
                place = np.append(middle_m, 0.0) + Rotation.from_euler("z", heading).apply(offset_m)
                placing.put(place, turned.as_quat(scalar_first=True))
        for _ in range(_SETTLE_TICKS):
            world.tick()
        with world.lock:
            first.stop()
            second.stop()
    return _jaw(pair, first, second, across)


def _free_place(world: World, region: Array, rng: np.random.Generator) -> Array:
    """Draw the pair's middle (2,) in the region; among other things the first that is free of them."""
    others = [body for body, name in world.objects.items() if name not in NAMES]
    outlines = [Placing(world.model, world.data, world.station.scene.pick_region_m, body).outline() for body in others]
    for _ in range(_DRAWS):
        middle_m = region.mean(axis=0) + rng.uniform(-0.25, 0.25, 2) * np.ptp(region, axis=0)
        if all(np.linalg.norm(outline[:, :2] - middle_m, axis=1).min() > _APART_M for outline in outlines):
            return np.asarray(middle_m)
    raise CycleFailure(Code.NO_GRASP, "there is no room for the pair among the other things")


# --- how they lie: offset [m] of the body's origin from the middle on the table, and its turn; x is across ------------

Poses = list[tuple[Array, Rotation]]


def _beside(pair: Pair, rng: np.random.Generator) -> Poses:
    one, other = pair.sizes_m
    least_m, most_m = (0.008, 0.014) if pair.kind == "binned" else (0.0, 0.001)
    gap_m, whole_m = float(rng.uniform(least_m, most_m)), one[0] + other[0]
    left = np.array([-whole_m / 2 + one[0] / 2 - gap_m / 2, 0.0, one[2] / 2])
    right = np.array([whole_m / 2 - other[0] / 2 + gap_m / 2, float(rng.uniform(-0.008, 0.008)), other[2] / 2])
    return [(left, Rotation.identity()), (right, Rotation.identity())]


def _on_top(pair: Pair, rng: np.random.Generator) -> Poses:
    one, other = pair.sizes_m
    shift = rng.uniform(-0.004, 0.004, 2)
    return [
        (np.array([0.0, 0.0, one[2] / 2]), Rotation.identity()),
        (np.array([*shift, one[2] + other[2] / 2 + 0.0005]), Rotation.identity()),
    ]


def _inside(_pair: Pair, rng: np.random.Generator) -> Poses:
    turn = Rotation.from_euler("z", float(rng.uniform(0, 2 * np.pi)))
    return [(np.zeros(3), Rotation.identity()), (np.array([0.0, 0.0, 0.014]), turn)]


def _through(_pair: Pair, rng: np.random.Generator) -> Poses:
    tilt = Rotation.from_euler("x", float(rng.uniform(70, 110)), degrees=True)
    flat, upright = np.array([0.0, 0.0, 0.036]), np.array([0.0, _RING_M, 0.031])
    return [(flat, Rotation.identity()), (upright, Rotation.from_euler("z", 90, degrees=True) * tilt)]


_POSES: dict[str, Callable[[Pair, np.random.Generator], Poses]] = {
    "touching": _beside, "binned": _beside, "stacked": _on_top, "nested": _inside, "linked": _through,
}  # fmt: skip


def _jaw(pair: Pair, first: Placing, second: Placing, across: Array) -> Jaw:
    """Close on both; of a stack and of linked rings on the first, which takes the other along."""
    held = np.concatenate([first.outline(), second.outline()]) if pair.kind[0] in "tnb" else first.outline()
    if pair.kind == "linked":
        towards = second.pose()[:2] - first.pose()[:2]
        towards = towards / max(float(np.linalg.norm(towards)), 1e-6)
        across = np.array([-towards[1], towards[0], 0.0])
    along_m = held @ across
    rest = np.array([-across[1], across[0], 0.0])
    middle = across * (along_m.min() + along_m.max()) / 2 + rest * float(np.median(held @ rest))
    if pair.kind == "nested":
        middle = np.append(first.pose()[:2], 0.0)
    tip_m = max(_LOWEST_M, float(second.outline()[:, 2].max()) - 0.040)
    turn = np.stack([np.cross(across, [0.0, 0.0, -1.0]), across, [0.0, 0.0, -1.0]], axis=1)
    tcp_m = np.array([middle[0], middle[1], tip_m + FINGER_TIP_M])
    return Jaw(from_rotation(turn, tcp_m), float(np.ptp(along_m)))


# --- the pieces -------------------------------------------------------------------------------------------------------


def _colors(rng: np.random.Generator, *, is_alike: bool) -> list[str]:
    first = rng.uniform(0.05, 0.95, 3)
    second = first if is_alike else (first + rng.uniform(0.35, 0.65, 3)) % 1.0
    return [" ".join(f"{value:.3f}" for value in (*rgb, 1.0)) for rgb in (first, second)]


def _side_by_side(rng: np.random.Generator, widest_m: float) -> tuple[Size, Size]:
    def one() -> Size:
        return float(rng.uniform(0.02, widest_m)), float(rng.uniform(0.045, 0.09)), float(rng.uniform(0.022, 0.04))

    return one(), one()


def _stack(rng: np.random.Generator) -> tuple[Size, Size]:
    lower = float(rng.uniform(0.05, 0.068)), float(rng.uniform(0.07, 0.1)), float(rng.uniform(0.014, 0.020))
    share = rng.uniform(0.6, 0.75, 2)
    return lower, (float(lower[0] * share[0]), float(lower[1] * share[1]), float(rng.uniform(0.012, 0.016)))


def _block(size_m: Size, rgba: str) -> str:
    half = " ".join(f"{side / 2:.5f}" for side in size_m)
    return _model([f'<geom type="box" size="{half}" rgba="{rgba}" density="{_DENSITY_KG_M3}"/>'])


def _cup(rgba: str) -> str:
    """A cup that widens upwards, so that another sits in it."""
    lean = np.arctan2(_RIM_M - _BOTTOM_M, _CUP_M)
    middle_m, half_m = (_RIM_M + _BOTTOM_M) / 2, np.pi * _RIM_M / _STAVES
    geoms = [f'<geom type="cylinder" size="{_BOTTOM_M} 0.002" pos="0 0 0.002" rgba="{rgba}" mass="0.01"/>']
    for turn in np.linspace(0, 2 * np.pi, _STAVES, endpoint=False):
        x, y, z, w = (Rotation.from_euler("z", turn) * Rotation.from_euler("y", lean)).as_quat()
        geoms.append(
            f'<geom type="box" size="{_WALL_M} {half_m:.5f} {_CUP_M / 2}" rgba="{rgba}" mass="{0.05 / _STAVES}"'
            f' pos="{middle_m * np.cos(turn):.5f} {middle_m * np.sin(turn):.5f} {_CUP_M / 2}"'
            f' quat="{w:.6f} {x:.6f} {y:.6f} {z:.6f}"/>'
        )
    return _model(geoms)


def _ring(rgba: str) -> str:
    corners = [
        (_RING_M * np.cos(turn), _RING_M * np.sin(turn)) for turn in np.linspace(0, 2 * np.pi, _PIECES, endpoint=False)
    ]
    return _model(
        f'<geom type="capsule" size="{_TUBE_M}" fromto="{a[0]:.5f} {a[1]:.5f} 0 {b[0]:.5f} {b[1]:.5f} 0"'
        f' rgba="{rgba}" mass="{0.06 / _PIECES}"/>'
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)
    )


def _model(geoms: Iterable[str]) -> str:
    return f"<mujoco><worldbody><body>{''.join(geoms)}</body></worldbody></mujoco>"
