"""Checks of a frame and of a camera pose. Whoever makes a `Frame`, a `View` or an `Observation` passes them.

So a driver of ours or of another package, the bus, a recording and a program are held to the same, once, and nothing
behind a message asks again. Frames, units and signs: docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import ValidationError

from bus.errors import BadFrame
from bus.first_mistake import first_mistake
from bus.frozen import Message
from bus.lazy import LazyModule

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from bus.messages.camera_model import CameraModel
else:
    np = LazyModule("numpy")

LENSES = (0, 4, 5, 8, 12, 14)
"""The numbers of distortion coefficients that OpenCV accepts."""
MADE_WRONG = "Correct that field where it is made, in the camera's driver or your program: see docs/frames.md."
_RIGID = 2e-3
"""Largest deviation of a rotation from an orthonormal one; a quaternion whose length is off by 1e-3 gives as much."""
_FARTHEST_M, _NEAREST_M = 20.0, 0.02
"""Where half of the measured pixels are beyond these, the unit is wrong: no depth camera of a cell measures there."""
_BASELINE_M, _REACH_M = 1.0, 20.0
"""Largest distance of the depth camera from the colour camera, and of the colour camera from ``base``."""
_LOOKED_AT = 10_000
"""Pixels whose middle depth is taken."""

MessageT = TypeVar("MessageT", bound=Message)


def made(name: str, values: Any, make: Callable[[Any], MessageT]) -> MessageT:
    """Make the message ``name``. Raises: BadFrame, naming the first field of another type or shape."""
    try:
        return make(values)
    except ValidationError as error:
        raise bad(f"{first_mistake(error, inside=name)}.") from error


def require_rgb(field: str, color: Any) -> None:
    """Require 8 bits in three channels of an image in memory. Raises: BadFrame, saying which channels it has."""
    if not isinstance(color, np.ndarray):
        return  # packed: its file says what it is
    channels = color.shape[2] if color.ndim == 3 else 1
    if color.ndim not in (2, 3) or channels != 3:
        kind = {1: "grey: repeat it three times", 4: "RGBA: leave the fourth away"}.get(channels, "none we know")
        raise bad(f"{field} has the shape {color.shape}, and RGB is (height, width, 3). This looks like {kind}.")
    if color.dtype != np.uint8:
        raise bad(f"{field} is of {color.dtype}, and RGB is of uint8, 0 to 255.")


def require_size(field: str, image: npt.NDArray[Any], lens_field: str, lens: CameraModel) -> None:
    """Require that an image has the size of its camera. Raises: BadFrame, with both sizes."""
    height, width = image.shape[:2]
    if (width, height) != (lens.width, lens.height) or 0 in (width, height):
        raise bad(
            f"{field} has {width} x {height} pixels, and {lens_field} is of a camera with {lens.width} x {lens.height}."
            " Scale the intrinsics with the image."
        )


def require_lens(field: str, lens: CameraModel) -> None:
    """Require finite intrinsics with positive focal lengths, and a lens that OpenCV has. Raises: BadFrame."""
    for name in ("fx", "fy", "cx", "cy"):
        value = getattr(lens, name)
        least = 0.0 if name in ("fx", "fy") else -np.inf  # the centre of a cropped image may lie outside it
        if not least < value < np.inf:  # written so that NaN fails
            wanted = "a positive number" if least == 0 else "a finite number"
            raise bad(f"{field}.{name} is {value}; it is {wanted} of pixels.")
    if len(lens.distortion) not in LENSES or not np.isfinite(lens.distortion).all():
        numbers = ", ".join(map(str, LENSES))
        raise bad(f"{field}.distortion is {lens.distortion}; a lens has {numbers} finite coefficients.")


def require_rigid(field: str, pose: npt.NDArray[np.float64], within_m: float = _REACH_M) -> None:
    """Require a right-handed, orthonormal, finite pose (4, 4) whose origin is near. Raises: BadFrame."""
    if not np.isfinite(pose).all():
        raise bad(f"{field} holds numbers that are not finite.")
    rotation = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers near the largest there are
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        away_m = float(np.linalg.norm(pose[:3, 3]))
    if not off <= _RIGID:  # written so that NaN fails
        raise bad(f"{field} is not rigid: its axes are not of length 1 and at right angles, by {off:.2g}.")
    if np.linalg.det(rotation) < 0:
        raise bad(f"{field} mirrors: its determinant is -1, and +1 in a right-handed frame. Turn one axis around.")
    if np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > _RIGID:
        raise bad(f"{field} ends with the row {pose[3].tolist()}, and a pose with 0, 0, 0, 1. Is it transposed?")
    if away_m > within_m:
        raise bad(
            f"{field} is {away_m:.4g} m away, at most {within_m:g} m. Poses are in metres: are these millimetres?"
        )


def require_baseline(field: str, pose: npt.NDArray[np.float64]) -> None:
    """Require a pose (4, 4) between the two cameras of one device. Raises: BadFrame, as `require_rigid`."""
    require_rigid(field, pose, _BASELINE_M)


def require_metres(field: str, depth_m: npt.NDArray[np.float32]) -> None:
    """Require that the middle depth is a camera's, if any was measured. Raises: BadFrame, naming the likely unit."""
    measured_m = depth_m[depth_m > 0]  # NaN compares false
    if not measured_m.size:
        return
    middle_m = float(np.median(measured_m[:: max(1, measured_m.size // _LOOKED_AT)]))
    if middle_m > _FARTHEST_M:
        raise bad(f"{field} says {middle_m:.4g} m in its middle. Depth is in metres: divide these millimetres by 1000.")
    if middle_m < _NEAREST_M:
        raise bad(f"{field} says {middle_m:.4g} m in its middle. Depth is in metres: was it divided by 1000 twice?")


def bad(text: str) -> BadFrame:
    """Return the error about a field, with advice for its maker: the operator of a cell gets that of `bus.codes`."""
    return BadFrame(text, MADE_WRONG)
