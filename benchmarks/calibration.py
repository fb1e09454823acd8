"""Hand-eye calibration in the simulated cell, with a camera mounted differently from its station file."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from typing import Any

from cell.hand_eye_survey import Surveyor, moved
from config.load import load_station
from drivers.node.registry import open_devices
from drivers.sim.optics import hand_from_cameras
from planning.robot import Robot

_ERROR_MM, _ERROR_DEG = 15.0, 3.0


def run(seeds: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Errors of the recovered ``hand_from_color`` (those of ``flange_from_color``: hand and flange are one body)."""
    every = [_one(seed, tell) for seed in range(1, seeds + 1)]
    return {
        "seeds": seeds,
        "mounting_error": {"mm": _ERROR_MM, "deg": _ERROR_DEG},
        "off_mm": {"median": median(one["off_mm"] for one in every), "max": max(one["off_mm"] for one in every)},
        "off_deg": {"median": median(one["off_deg"] for one in every), "max": max(one["off_deg"] for one in every)},
        "each": every,
    }


def _one(seed: int, tell: Callable[[str], None]) -> dict[str, float]:
    settings = ("board=true", f"mounting_error_mm={_ERROR_MM}", f"mounting_error_deg={_ERROR_DEG}", f"seed={seed}")
    station = load_station(overrides=[f"sim.{setting}" for setting in settings])
    devices = open_devices("sim", station)
    assert devices.arm is not None and devices.camera is not None, "the simulation serves all devices"
    devices.arm.connect()
    devices.camera.connect()
    found = Surveyor(devices, Robot(station), station, tell).calibrate()
    devices.camera.close()
    off_mm, off_deg = moved(hand_from_cameras(station)["color"], found.hand_from_color)
    tell(f"seed {seed}: {off_mm:.3f} mm, {off_deg:.3f} deg off")
    return {"off_mm": off_mm, "off_deg": off_deg, "rms_px": found.rms_px}
