"""The images of a report page, as data URIs."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import Detections, Frame, Rectangle
from bus.rejection import Rejection

_OUTLINE_RGB, _CHOSEN_RGB, _OTHER_RGB, _REJECTED_RGB = (10, 200, 120), (255, 214, 10), (235, 240, 245), (240, 80, 80)
_LEAST_DEPTH_SHARE, _MOST_DEPTH_SHARE = 1, 99
_JPEG_QUALITY = 85

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
Pixels = TypeVar("Pixels", Image, Mask)


def data_uri(image: Image | Mask, *, width_px: int = 960) -> str:
    """An RGB image (H, W, 3) or mask (H, W) as a JPEG or PNG data URI, at most ``width_px`` wide."""
    pixels = image.astype(np.uint8) * 255 if image.dtype == np.bool_ else np.asarray(image[..., ::-1])
    if pixels.shape[1] > width_px:
        height_px = round(pixels.shape[0] * width_px / pixels.shape[1])
        pixels = cv2.resize(pixels, (width_px, height_px), interpolation=cv2.INTER_AREA)
    kind = "png" if image.dtype == np.bool_ else "jpeg"
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if kind == "jpeg" else []
    _, encoded = cv2.imencode(f".{kind}", pixels, options)
    return f"data:image/{kind};base64,{base64.b64encode(encoded.tobytes()).decode()}"


def file_uri(image: bytes | None) -> str:
    """A picture's file, unchanged, as a data URI; "" for none. Torn files are not repaired."""
    if image is None:
        return ""
    kind = "jpeg" if image.startswith(b"\xff\xd8") else "png"
    return f"data:image/{kind};base64,{base64.b64encode(image).decode()}"


def undistorted(frame: Frame) -> Image:
    """Return the colour image (H, W, 3) of a frame without its lens's distortion, as detect sees it."""
    camera = frame.color_camera
    if not camera.distortion:
        return frame.color
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    return np.asarray(cv2.undistort(np.asarray(frame.color), matrix, np.array(camera.distortion)), dtype=np.uint8)


def annotated(found: Detections, grasp: int | None, rejections: Iterable[Rejection]) -> Image:
    """Return the colour image (H, W, 3) with the object's outline and the grasp rectangles: chosen, rejected, others.

    Args:
        grasp: index of the chosen one, None for none.
    """
    image = np.array(found.evidence.color)
    contours, _ = cv2.findContours(
        found.evidence.object_mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(image, contours, -1, _OUTLINE_RGB, 2, cv2.LINE_AA)
    chosen = found.grasps[grasp].rectangle if grasp is not None else -1
    rejected = {found.grasps[one.grasp].rectangle for one in rejections}
    for index, rectangle in enumerate(found.rectangles):
        if index != chosen:
            color = _REJECTED_RGB if index in rejected else _OTHER_RGB
            cv2.polylines(image, [_corners(rectangle)], True, color, 1, cv2.LINE_AA)
    if 0 <= chosen < len(found.rectangles):
        cv2.polylines(image, [_corners(found.rectangles[chosen])], True, _CHOSEN_RGB, 3, cv2.LINE_AA)
    return image


def _corners(rectangle: Rectangle) -> npt.NDArray[np.int32]:
    return np.rint(rectangle.corners_px()).astype(np.int32)


def crop(image: Pixels, mask: Mask, margin_px: int = 90) -> Pixels:
    """Return the part of ``image`` (H, W, ...) around ``mask`` (H, W) with a margin; all of it for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return image
    top, left = max(0, rows[0] - margin_px), max(0, columns[0] - margin_px)
    return image[top : rows[-1] + margin_px, left : columns[-1] + margin_px]


def colored_depth(depth_m: npt.NDArray[np.float32]) -> tuple[Image, str]:
    """Depth (H, W) [m] in colours, and the legend in words; unmeasured pixels are black."""
    measured = np.isfinite(depth_m)
    if not measured.any():
        return np.zeros((*depth_m.shape, 3), np.uint8), "nothing was measured"
    near_m, far_m = np.percentile(depth_m[measured], [_LEAST_DEPTH_SHARE, _MOST_DEPTH_SHARE])
    share = np.clip((np.nan_to_num(depth_m, nan=far_m) - near_m) / max(far_m - near_m, 1e-6), 0, 1)
    image = cv2.applyColorMap((255 * (1 - share)).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1].copy()
    image[~measured] = 0
    return image, f"red {near_m:.2f} m to blue {far_m:.2f} m; black {1 - measured.mean():.0%}: not measured"
