"""The draws from a scene's seed before anything moves: its kind, and where table and camera truly are.

MuJoCo's world is the frame ``table`` here: its top is z = 0, level. In ``base``, which leans where the table should be
level, it lies off and tilted; so round things do not roll away, and everything on it keeps its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

import config
from bus.transforms import from_rotation, from_translation, inverse
from config.load import load_station
from config.schema import Station
from drivers.sim.optics import hand_from_cameras
from planning.robot import Robot

TABLE_OFF_M, TABLE_TILT_DEG = 0.008, 3.0
"""The table is off by up to so much, either way."""
MOUNTING_ERROR_MM, MOUNTING_ERROR_DEG = 1.0, 0.3
HEAPS, TALL, BOWLS, BOXES = "heaps", "tall", "bowls", "boxes"
SETS = (HEAPS, TALL, BOWLS, BOXES)
"""Kinds of scenes: heaps of real shapes, or one thing that is hard from above (`benchmarks.heaps.things`)."""
_PAIR_EVERY, _PAIR_AT = 10, 5
_BIN = Path(config.__file__).with_name("bin.toml")

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """One scene before it is dropped.

    Attributes:
        kind: "table" or "bin". ``pair``: "same" or "different" colours of two equal boxes lying flush, or "" for none.
        base_from_table: (4, 4) true pose of the table in ``base``; the station has it at the identity.
        true_base_from_color: (4, 4) of the camera. ``base_from_color``: what the station takes it for.
        set_name: one of `SETS`.
    """

    n: int
    seed: int
    kind: str
    pair: str
    base_from_table: Array
    base_from_color: Array
    true_base_from_color: Array
    set_name: str = HEAPS

    def rng(self, purpose: int) -> np.random.Generator:
        """Return random numbers of this scene, others for each ``purpose``."""
        return np.random.default_rng([self.seed, self.n, purpose, *_of_set(self.set_name)])


def plan(n: int, seed: int, set_name: str = HEAPS) -> Plan:
    """Draw the scene: of heaps every second two seeds are in a bin, and every tenth has a pair of flush boxes."""
    kind = "bin" if seed // 2 % 2 and set_name == HEAPS else "table"
    has_pair = n > 1 and seed % _PAIR_EVERY == _PAIR_AT
    pair = ("different" if seed // _PAIR_EVERY % 2 else "same") if has_pair else ""
    station = station_of(kind)
    sim = station.sim.model_copy(
        update={"seed": seed, "mounting_error_mm": MOUNTING_ERROR_MM, "mounting_error_deg": MOUNTING_ERROR_DEG}
    )
    astray = station.model_copy(update={"sim": sim})
    robot, q_rad = Robot(station), np.array(station.arm.capture_q_rad)
    truth = robot.base_from_hand(q_rad) @ hand_from_cameras(astray)["color"]
    return Plan(n, seed, kind, pair, _table(station, n, seed), robot.base_from_color(q_rad), truth, set_name)


def _of_set(set_name: str) -> tuple[int, ...]:
    """Return what a set adds to its seeds; nothing for heaps."""
    return (SETS.index(set_name),) if set_name != HEAPS else ()


@cache
def station_of(kind: str, overrides: tuple[str, ...] = ()) -> Station:
    """Return the station of a "table" or a "bin" (config/bin.toml): the same pick region in both."""
    in_bin = load_station(_BIN, overrides)
    if kind == "bin":
        return in_bin
    region_m = list(in_bin.scene.pick_region_m)
    return load_station(None, (f"scene.pick_region_m={region_m}", *overrides))


def _table(station: Station, n: int, seed: int) -> Array:
    """Return the pose: off along z and turned about a level axis through the middle of the pick region."""
    rng = np.random.default_rng([seed, n, 1])
    off_m, tilt_rad = rng.uniform(-TABLE_OFF_M, TABLE_OFF_M), np.deg2rad(rng.uniform(-TABLE_TILT_DEG, TABLE_TILT_DEG))
    direction = rng.uniform(0, np.pi)
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, 0.0])
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    turn = from_rotation(Rotation.from_rotvec(tilt_rad * axis).as_matrix(), middle + off_m * np.eye(3)[2])
    return np.asarray(turn @ inverse(from_translation(middle)))
