"""Simulates a time-of-flight sensor from true depth: noise, mixed and missing pixels, range, the hexagonal mask.

Model (fitted to the data sheet, not to a unit): sigma^2 = s0^2 + (a d / sqrt(rho))^2 + (b d^2 / rho)^2, 17 mm at
3.86 m and reflectivity 0.15 (Femto Mega / Azure Kinect NFOV unbinned: 0.50-3.86 m).
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

MIN_RANGE_M, MAX_RANGE_M = 0.50, 3.86
_S0_M, _A, _B = 0.0005, 0.0008, 0.00015
_REFLECTIVITY = 0.5
_BIAS_M = 0.001
_EDGE_M = 0.010
_STEP_M = 0.001

DepthImage = npt.NDArray[np.float32]


def sense(depth_m: DepthImage, rng: np.random.Generator, bias_seed: int, scale: float) -> DepthImage:
    """Return a measured depth image (H, W) [m], NaN = invalid, from a true one.

    Args:
        rng: this frame's random numbers.
        bias_seed: of the unit's smooth systematic error.
        scale: of all errors; 0 leaves only range, mask and quantisation.
    """
    measured = depth_m.astype(np.float64)
    if scale > 0:
        measured = _mix_edges(measured, rng)
        sigma_m = np.sqrt(
            _S0_M**2 + (_A * measured / np.sqrt(_REFLECTIVITY)) ** 2 + (_B * measured**2 / _REFLECTIVITY) ** 2
        )
        measured += scale * (sigma_m * rng.standard_normal(measured.shape) + _bias(measured.shape, bias_seed))
    measured = np.round(measured / _STEP_M) * _STEP_M
    invalid = (measured < MIN_RANGE_M) | (measured > MAX_RANGE_M) | ~_hexagon(measured.shape)
    measured[invalid] = np.nan
    return measured.astype(np.float32)


def _mix_edges(depth_m: npt.NDArray[np.float64], rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Return the image with half of the pixels across a depth edge invalid, the other half a mixture of both sides."""
    kernel = np.ones((3, 3))
    far, near = cv2.dilate(depth_m, kernel), cv2.erode(depth_m, kernel)
    edge = far - near > _EDGE_M
    share = rng.uniform(size=depth_m.shape)
    mixed = near + share * (far - near)
    lost = rng.uniform(size=depth_m.shape) < 0.5
    return np.where(edge, np.where(lost, np.nan, mixed), depth_m)


def _bias(shape: tuple[int, ...], seed: int) -> npt.NDArray[np.float64]:
    """Return a smooth error field of about one millimetre, fixed for one unit."""
    coarse = np.random.default_rng(seed).standard_normal((5, 5)) * _BIAS_M
    return np.asarray(cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC))


def _hexagon(shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    """Return the illuminated part of the image; its corners are dark."""
    y, x = np.meshgrid(np.linspace(-1, 1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    return np.asarray(np.abs(x) + 0.5 * np.abs(y) < 1.25)
