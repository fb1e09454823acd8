"""Checks of a detector's grasps at the door: numbers that can be one, each refusal with the field's name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from perception.detectors.base import FoundGrasp, SeenScene

_MOST_OFF = 1e-3
"""Largest entry of R^T R - 1: networks compute in single precision. What passes is made exact."""


def checked(name: str, given: object, seen: SeenScene) -> tuple[FoundGrasp, ...]:
    """Return the grasps, their rotations made exact.

    Args:
        name: of the detector. ``given``: what it returned.

    Raises: CycleFailure(DETECTOR_FAILED), which names the detector, the grasp and the field.
    """
    if not isinstance(given, Sequence) or isinstance(given, str | bytes):
        raise _refused(name, f"gave {type(given).__name__}, and no sequence of grasps")
    return tuple(_checked(f"grasp {index}", name, one, seen) for index, one in enumerate(given))


def _checked(which: str, name: str, one: object, seen: SeenScene) -> FoundGrasp:
    if not isinstance(one, FoundGrasp):
        raise _refused(name, f"gave {type(one).__name__} as {which}, and no FoundGrasp")
    try:
        pose = np.array(one.base_from_tcp, dtype=float)
        width_m, score = float(one.width_m), float(one.score)
        instance = None if one.instance is None else int(one.instance)
    except (TypeError, ValueError) as error:
        raise _refused(name, f"gave a {which} that is not made of numbers: {error}") from error
    most_m = seen.hand.max_width_m
    if not (np.isfinite(width_m) and 0 < width_m <= most_m):
        text = f"gave {which} with width_m = {width_m:g}: it lies in (0, {most_m:g}], as far as the jaw opens"
        raise _refused(name, text)
    if not (np.isfinite(score) and 0 <= score <= 1):
        raise _refused(name, f"gave {which} with score = {score:g}: it lies between 0 and 1")
    if instance is not None and (instance != one.instance or not 1 <= instance <= len(seen.things)):
        raise _refused(name, f"gave {which} with instance = {one.instance}: there are things 1 to {len(seen.things)}")
    return FoundGrasp(_pose(which, name, pose), width_m, score, instance)


def _pose(which: str, name: str, pose: Transform) -> Transform:
    """The pose, with the nearest rotation to its own."""
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise _refused(name, f"gave {which} whose base_from_tcp is not (4, 4) of finite numbers")
    rotation = pose[:3, :3]
    off = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if off > _MOST_OFF or np.linalg.det(rotation) < 0 or np.abs(pose[3] - [0, 0, 0, 1]).max() > _MOST_OFF:
        raise _refused(name, f"gave {which} whose base_from_tcp is no rotation and translation")
    left, _, right = np.linalg.svd(rotation)
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = left @ right, pose[:3, 3]
    return exact


def _refused(name: str, what: str) -> CycleFailure:
    return CycleFailure(Code.DETECTOR_FAILED, f"The detector {name!r} {what}.")
