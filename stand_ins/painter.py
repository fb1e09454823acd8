"""The image model of the model server: finds an axis in the image, describes it in pixels, and paints a rod.

Its input is that of a hosted model, an image and a prompt; it knows nothing of the cell.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.baselines.flat import flat_object
from bus.transforms import apply, inverse
from config.load import load_station
from perception.geometry.lift import project
from perception.goal.imagine import ROD_COLORS
from perception.models.painter import paint as paint_rod
from perception.observed_object import ObservedObject, RodColor
from stand_ins.asked import Picture

_STATION = load_station(None, ["hand.max_width_m=0.1"])
"""A model that sees a picture does not know to the millimetre what fits the jaw."""
_AXIS = re.compile(r"from pixel \((-?[\d.]+), (-?[\d.]+)\) to pixel \((-?[\d.]+), (-?[\d.]+)\)")
_SCALE = re.compile(r"about ([\d.]+) pixels")
_LEVEL_M = 0.02
_STICK_OUT_M = 0.035
_STANDS_OUT = 24

Image = npt.NDArray[np.uint8]


def say(prompt: str, image: Image | None) -> str:
    """Reasoning about a picture, or the directive that repeats a reasoning's axis."""
    known = _AXIS.search(prompt)
    if known is not None:
        return f"Draw one straight rod through the object, {known.group(0)}, sticking out on both sides."
    if image is None:
        return "There is no picture."
    start, end = _axis_px(_subject(image, prompt))
    return (
        "The object has two opposite, nearly parallel faces near its middle. The fingers close along the axis "
        f"from pixel ({start[0]:.1f}, {start[1]:.1f}) to pixel ({end[0]:.1f}, {end[1]:.1f})."
    )


def paint(picture: Picture) -> Image:
    """The picture with a rod along the axis of the prompt, or along one of its own choice."""
    observed_object = _subject(picture.image, picture.prompt)
    known = _AXIS.search(picture.prompt)
    ends_px = (
        np.array([float(number) for number in known.groups()]).reshape(2, 2) if known else _axis_px(observed_object)
    )
    camera, depth_m = observed_object.rgbd.camera, observed_object.base_from_color[2, 3] - _LEVEL_M
    rays = np.column_stack([(ends_px - [camera.cx, camera.cy]) / camera.fx, np.ones(2)])
    goal = paint_rod(observed_object, rays * depth_m, _STATION.perception.rod_radius_m)
    rod = (goal.image != observed_object.masked).any(axis=2)
    return np.where(rod[..., None], goal.image, picture.image)


def object_mask(image: Image) -> npt.NDArray[np.bool_]:
    """Return what stands out from the picture's rim."""
    rim = np.concatenate([image[:4].reshape(-1, 3), image[-4:].reshape(-1, 3)])
    apart = np.abs(image.astype(np.int16) - np.median(rim, axis=0)).max(axis=2)
    return np.asarray(cv2.morphologyEx((apart > _STANDS_OUT).astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5))) > 0)


def _subject(image: Image, prompt: str) -> ObservedObject:
    """The picture as a flat scene at the prompt's scale, its rod in the prompt's colour."""
    scale = _SCALE.search(prompt)
    m_per_px = 1e-3 / float(scale.group(1)) if scale else 0.15 / image.shape[0]
    observed_object = _flat(image.tobytes(), image.shape, m_per_px)
    color = next((color for color in ROD_COLORS if color.name in prompt), ROD_COLORS[0])
    return replace(observed_object, masked=image, rod=RodColor(color.name, color.rgb))


@lru_cache(maxsize=4)
def _flat(image: bytes, shape: tuple[int, ...], m_per_px: float) -> ObservedObject:
    """The same picture is shown again with each step and by every test: its grasps are searched once."""
    picture = np.frombuffer(image, np.uint8).reshape(shape)
    return flat_object(picture, object_mask(picture), m_per_px, _STATION)


def _axis_px(observed_object: ObservedObject) -> np.ndarray:
    """Ends (2, 2) of the best axis, sticking out."""
    if not observed_object.axes:
        return _minor_axis_px(observed_object)
    contacts = observed_object.axes[0].ends_base
    along = (contacts[1] - contacts[0]) / np.linalg.norm(contacts[1] - contacts[0])
    ends_base = contacts + np.outer([-_STICK_OUT_M, _STICK_OUT_M], along)
    return project(apply(inverse(observed_object.base_from_color), ends_base), observed_object.rgbd.camera)


def _minor_axis_px(observed_object: ObservedObject) -> np.ndarray:
    """Ends (2, 2) of the shortest way through the middle, for what is wider than the jaw."""
    rows, columns = np.nonzero(observed_object.mask)
    pixels = np.stack([columns, rows], axis=1).astype(float)
    values, axes = np.linalg.eigh(np.cov(pixels.T))
    half = axes[:, 0] * (2 * np.sqrt(values[0]) + 0.12 * observed_object.rgbd.camera.width)
    return np.asarray(pixels.mean(axis=0) + np.stack([-half, half]))
