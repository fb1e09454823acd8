"""Checks the arguments of ``detect``, one by one: each refusal says what was received, and what to pass instead."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.errors import BadFrame
from bus.messages import CameraModel, Frame, Observation, View
from bus.messages.frame_checks import LENSES, require_rigid

Numbers = npt.NDArray[np.float64]
Image = npt.NDArray[Any]

_FARTHEST_M, _NEAREST_M = 20.0, 0.02
_LEAST_FOCAL, _MOST_FOCAL = 0.1, 20.0
"""Focal lengths in widths of the picture: an opening angle of 157 and of 3 degrees."""
_MOST_OBLONG = 2.0
"""Largest ratio of the focal lengths, of a picture that was stretched."""
_BORDER = 0.1
"""The principal point is this part of the picture's size inside it; also where the picture was cropped."""
_ALIKE, _HALF = 0.03, 0.36
"""Nearer to the corner in the same proportion both ways than this, it is the middle of a picture of another size."""
_POSE = "Pass the pose of the camera in base, (4, 4), in metres; optical frame: x right, y down, z forward."
_PINHOLE = "It is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], or fx, fy, cx, cy; in pixels of this picture."


def observed(color: Any, depth_m: Any, K: Any, base_from_camera: Any, distortion: Sequence[float] = ()) -> Observation:
    """Return the arrays as the observation of a cell; the arguments are those of `vlad_cell.detect`.

    Raises: BadFrame, which names the argument, what was received, and what to pass.
    """
    color = _color(_array("color", color))
    depth_m = _depth(_array("depth_m", depth_m), color)
    height, width = color.shape[:2]
    fx, fy, cx, cy = _pinhole(_floats("K", K), width, height)
    camera = CameraModel(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, distortion=_lens(distortion))
    pose = _pose(_floats("base_from_camera", base_from_camera))
    frame = Frame(
        stamp_ns=0,
        color=color,
        depth_m=depth_m,
        color_camera=camera,
        depth_camera=camera,
        color_from_depth=np.eye(4),
    )
    return Observation(view=View(stamp_ns=0, base_from_color=pose), frame=frame)


def _array(name: str, given: Any) -> Image:
    if np.ma.is_masked(given):  # its mask would be forgotten
        raise BadFrame(f"{name} is a masked array.", f"Pass {name}.filled(np.nan), or of integers {name}.filled(0).")
    if given is None:
        raise BadFrame(f"{name} is None.", "Pass a numpy array of numbers.")
    try:
        array = np.asarray(given)
    except ValueError as error:  # rows of several lengths
        raise BadFrame(f"{name} is no array: {error}.", "Pass a numpy array of numbers.") from error
    if array.dtype.kind not in "uif":
        raise BadFrame(f"{name} is of {array.dtype}, and no numbers.", "Pass a numpy array of numbers.")
    return array


def _floats(name: str, given: Any) -> Numbers:
    array = _array(name, given).astype(float)
    if not np.isfinite(array).all():
        raise BadFrame(f"{name} holds numbers that are not finite: {array.tolist()}.", "Pass finite numbers.")
    return array


# --- the images -------------------------------------------------------------------------------------------------------


def _color(color: Image) -> npt.NDArray[np.uint8]:
    if color.ndim != 3 or color.shape[2] != 3 or 0 in color.shape:
        raise BadFrame(f"color has the shape {color.shape}; it is (H, W, 3).", _reshaped(color))
    if color.dtype == np.uint8:
        return color
    least, most = float(np.nanmin(color)), float(np.nanmax(color))
    said = f"color is of {color.dtype}, from {least:.4g} to {most:.4g}; it is RGB of uint8, 0 to 255."
    if color.dtype.kind == "f" and least >= 0 and most <= 1:
        raise BadFrame(said, "Pass (255 * color).round().astype(np.uint8).")
    if least >= 0 and most <= 255:
        raise BadFrame(said, "Pass color.astype(np.uint8).")
    if color.dtype == np.uint16:
        raise BadFrame(said, "Pass (color >> 8).astype(np.uint8), if all 16 bits are used.")
    raise BadFrame(said, "Scale it to 0 to 255, and pass it as np.uint8.")


def _reshaped(color: Image) -> str:
    """Return what to pass instead of a colour image of another shape."""
    if color.ndim == 2 or (color.ndim == 3 and color.shape[2] == 1):
        return "A grey image: pass np.dstack([color] * 3)."
    if color.ndim == 3 and color.shape[2] == 4:
        return "RGBA: pass color[..., :3]."
    if color.ndim == 3 and color.shape[0] == 3:
        return "The channels come first: pass np.moveaxis(color, 0, -1)."
    if color.ndim == 4 and color.shape[0] == 1:
        return "A batch of one: pass color[0]."
    return "Pass one RGB image."


def _depth(depth_m: Image, color: Image) -> npt.NDArray[np.float32]:
    size_px = color.shape[:2]
    if depth_m.shape != size_px:
        said = (
            f"depth_m has the shape {depth_m.shape}, and color {color.shape}; depth is (H, W) in the pixels of color."
        )
        raise BadFrame(said, _registered(depth_m, size_px))
    measured = depth_m[(depth_m > 0) & (depth_m < np.inf)]  # NaN compares false
    if not measured.size:
        what = f"depth_m holds nothing measured: none of its {depth_m.size} pixels is a positive number."
        raise BadFrame(
            what, "Depth is positive along the optical axis, in metres; 0 or NaN where nothing was measured."
        )
    middle_m = float(np.median(measured))
    if not _NEAREST_M <= middle_m <= _FARTHEST_M:
        raise BadFrame(f"depth_m says {middle_m:.4g} m in its middle; it is in metres.", _in_metres(depth_m, middle_m))
    return depth_m.astype(np.float32)


def _registered(depth_m: Image, size_px: tuple[int, ...]) -> str:
    """Return what to pass instead of a depth image of another shape."""
    if depth_m.ndim == 3 and depth_m.shape == (*size_px, 3):
        return "This is a picture of the depth, whose colours are no distances: pass the depth itself."
    if depth_m.ndim == 3 and 1 in depth_m.shape and sorted(depth_m.shape)[1:] == sorted(size_px):
        return "Pass depth_m.squeeze()."
    if depth_m.shape == size_px[::-1]:
        return "It is turned: pass depth_m.T, if it is not another image."
    return "Register the depth to the colour image first, as the camera's software does; another size is not enough."


def _in_metres(depth_m: Image, middle: float) -> str:
    if depth_m.dtype == np.uint8:
        return "This is a picture of the depth, whose greys are no distances: pass the depth itself."
    if middle < _NEAREST_M:
        return "Was it divided by 1000 twice?"
    scale = next((scale for scale in (1000, 10_000) if _NEAREST_M <= middle / scale <= _FARTHEST_M), None)
    unit = {1000: "millimetres", 10_000: "tenths of a millimetre"}
    return f"If these are {unit[scale]}, divide them by {scale}." if scale else "Convert it to metres."


# --- the camera -------------------------------------------------------------------------------------------------------


def _pinhole(K: Numbers, width: int, height: int) -> Numbers:
    """fx, fy, cx, cy [px]."""
    if K.shape == (3, 3):
        if K[2, :2].any() and not K[:2, 2].any():
            raise BadFrame(f"K is transposed: {K.tolist()}.", "Pass K.T.")
        if K[0, 1] or K[1, 0] or K[2].tolist() != [0, 0, 1]:
            raise BadFrame(f"K is no matrix of a pinhole camera: {K.tolist()}.", _PINHOLE)
        K = K[[0, 1, 0, 1], [0, 1, 2, 2]]
    if K.shape != (4,):
        instead = {(3, 4): "Pass K[:, :3]. ", (4, 4): "Pass K[:3, :3]. ", (9,): "Pass np.reshape(K, (3, 3)). "}
        raise BadFrame(f"K has the shape {K.shape}.", f"{instead.get(K.shape, '')}{_PINHOLE}")
    fx, fy, cx, cy = K
    picture = f"a picture of {width} x {height} px"
    if fx <= 0 or fy <= 0:
        raise BadFrame(f"K: fx is {fx:g} and fy {fy:g}; both are positive numbers of pixels.", _PINHOLE)
    if max(fx, fy, abs(cx), abs(cy)) <= 2:
        what = f"K has fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}, like the identity: no pixels of {picture}."
        raise BadFrame(what, f"If they are parts of the picture, multiply by its size. {_PINHOLE}")
    if not (_LEAST_FOCAL <= fx / width <= _MOST_FOCAL and 1 / _MOST_OBLONG <= fx / fy <= _MOST_OBLONG):
        angle_deg = np.degrees(2 * np.arctan(width / (2 * fx)))
        what = f"K has the focal lengths {fx:g} and {fy:g} px, for {picture}: it would see {angle_deg:.0f} degrees."
        raise BadFrame(what, f"They are in pixels, not in millimetres, and nearly equal. {_PINHOLE}")
    _require_middle(cx / width, cy / height, f"K has its principal point at ({cx:g}, {cy:g}) px, for {picture}")
    return np.asarray(K)


def _require_middle(u: float, v: float, said: str) -> None:
    """Require the principal point well inside the picture, at parts (u, v) of its size. Raises: BadFrame."""
    if not (_BORDER <= u <= 1 - _BORDER and _BORDER <= v <= 1 - _BORDER):
        raise BadFrame(
            f"{said}: it lies outside its middle.",
            "Is K of a picture of another size? Scale fx, cx with its width and fy, cy with its height. Pad a picture"
            " that was cut out until the point is well inside.",
        )
    if abs(u - v) < _ALIKE and not _HALF <= (u + v) / 2 <= 1 - _HALF:
        raise BadFrame(
            f"{said}: the middle of one of {u + v:.0%} of that size.",
            "Scale K with the picture, or pad one that was cut out.",
        )


def _lens(distortion: Sequence[float]) -> tuple[float, ...]:
    lens = _floats("distortion", distortion)
    if lens.ndim != 1 or len(lens) not in LENSES:
        numbers = ", ".join(map(str, LENSES))
        raise BadFrame(f"distortion has the shape {lens.shape}.", f"Pass {numbers} coefficients, in OpenCV's order.")
    return tuple(lens.tolist())


def _pose(base_from_camera: Numbers) -> Numbers:
    if base_from_camera.shape != (4, 4):
        instead = {
            (3, 4): "Pass np.vstack([base_from_camera, [0, 0, 0, 1]]). ",
            (16,): "Pass np.reshape(base_from_camera, (4, 4)). ",
        }.get(base_from_camera.shape, "")
        raise BadFrame(f"base_from_camera has the shape {base_from_camera.shape}.", f"{instead}{_POSE}")
    if base_from_camera[3, :3].any() and not base_from_camera[:3, 3].any():
        raise BadFrame("base_from_camera is transposed: its last row holds the position.", "Pass base_from_camera.T.")
    try:
        require_rigid("base_from_camera", base_from_camera)
    except BadFrame as error:
        raise BadFrame(error.text, _POSE) from error
    return base_from_camera
