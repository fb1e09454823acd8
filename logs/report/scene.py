"""The scene that detect saw, and what it tried, as pictures and tables of a page; also of a failed detection."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Mask, Transform
from bus.messages import CameraModel, Detections, Instance, Observation, ObservedScene, SeenTable, Tried
from bus.transforms import apply, inverse
from logs.mcap.reader import CycleRecord
from logs.mcap.unseen_scene import is_made_up
from logs.recorded_settings import recorded_number
from logs.report.images import Image, crop, undistorted
from logs.report.look_points import true_pose
from logs.report.page import Fact
from logs.scene_picture import color_of, draw_scene

_MARGIN_PX = 100
_LEAST_DEPTH_SHARE = 0.7
"""A thing with less depth is marked; of the simulated ones only the cup, into which the camera cannot see, has less."""

Array = npt.NDArray[np.float64]


class Thing(NamedTuple):
    """One row of the legend: a thing's number, its colour in CSS, its size and how completely it was seen.

    Attributes:
        is_doubtful: the border cuts it, or it lacks depth.
    """

    number: int
    color: str
    size: str
    depth: str
    border: str
    is_doubtful: bool


class Attempt(NamedTuple):
    """One rod that was imagined. ``outcome``: the score of its best grasp, or the code it failed with."""

    number: int
    color: str
    sample: int
    outcome: str
    text: str
    failed: bool


class SceneView(NamedTuple):
    """The scene on the page.

    Attributes:
        picture: (h, w, 3) around the pick region. ``facts``: of the table and of the region.
        things: the legend. ``tried``: the rods that were imagined, in order.
    """

    picture: Image
    facts: list[Fact]
    things: list[Thing]
    tried: list[Attempt]


def scene_view(record: CycleRecord, found: Detections | None) -> SceneView | None:
    """Return the scene of a cycle; None where none was recorded, or the reader made it up for an older recording."""
    scene = record.scene
    if scene is None or is_made_up(scene):
        return None
    corners = region_px(record, scene.table, record.observation)
    picture = draw_scene(color_image(record, found, scene.labels.shape), scene, corners)
    return SceneView(
        crop(picture, what_to_show(scene, corners), margin_px=_MARGIN_PX),
        _facts(record, scene.table, scene.region_seen),
        [_thing(one) for one in scene.instances],
        [_attempt(one) for one in found.tried] if found is not None else [],
    )


def what_to_show(scene: ObservedScene, corners: Array | None) -> Mask:
    """(H, W) what the picture must show: the things, what was not seen, and the pick region as far as it is in view."""
    shown = ((scene.labels > 0) | scene.unseen).astype(np.uint8)
    if corners is not None:
        cv2.fillPoly(shown, [np.rint(corners).astype(np.int32)], (1,))
    return shown > 0


def color_image(record: CycleRecord, found: Detections | None, shape: tuple[int, ...]) -> Image:
    """Return the undistorted colour image; grey, of the given shape (H, W), where the recording lost the frame."""
    if found is not None:
        return found.evidence.color
    if record.observation is not None:
        return undistorted(record.observation.frame)
    return np.full((*shape, 3), 128, dtype=np.uint8)


def region_px(record: CycleRecord, table: SeenTable, observation: Observation | None) -> Array | None:
    """Return the corners (4, 2) of the pick region on the seen table, in a look's undistorted colour image; or None."""
    settings = record.station.get("scene")
    region_m = settings.get("pick_region_m") if isinstance(settings, dict) else None
    if observation is None or not isinstance(region_m, list) or len(region_m) != 4:
        return None
    x_min, x_max, y_min, y_max = (float(bound) for bound in region_m)
    corners = np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
    points = np.column_stack([corners, _height_m(table.base_from_table, corners)])
    return pixels_of(apply(inverse(true_pose(observation, record.scene)), points), observation.frame.color_camera)


def _height_m(base_from_table: Transform, xy_m: Array) -> Array:
    """Height (n,) of the table at places (n, 2) of ``base``."""
    normal, origin = base_from_table[:3, 2], base_from_table[:3, 3]
    return np.asarray(origin[2] - (xy_m - origin[:2]) @ normal[:2] / normal[2])


def pixels_of(points_color: Array, camera: CameraModel) -> Array | None:
    """Pixels (n, 2) of points (n, 3) in the camera's frame, without distortion; None when one lies behind it."""
    x, y, z = points_color.T
    if (z <= 0).any():
        return None
    return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)


def _facts(record: CycleRecord, table: SeenTable, region_seen: float) -> list[Fact]:
    """The table's place beside what the recorded station tolerates, and how much of the pick region was seen."""

    def limit(form: str, *keys: str, times: float = 1.0) -> str:
        value = recorded_number(record.station, *keys)
        return "-" if value is None else form.format(value * times)

    tolerance_mm = limit("at most ±{:g} mm", "scene", "table", "tolerance_mm")
    tolerance_deg = limit("at most {:g}°", "scene", "table", "tolerance_deg")
    needed = limit("at least {:.0f} % to call it empty", "perception", "min_table_seen", times=100)
    return [
        Fact("height over the station's table", f"{table.offset_m * 1e3:+z.1f} mm", tolerance_mm),
        Fact("tilt", f"{np.degrees(table.tilt_rad):.1f}°", tolerance_deg),
        Fact("seen of the pick region", f"{region_seen:.0%}", needed),
    ]


def _thing(one: Instance) -> Thing:
    length, width, height = (f"{side_m * 1e3:.0f}" for side_m in one.size_m)
    return Thing(
        one.number,
        css_color(one.number),
        f"{length} x {width} x {height} mm",
        f"{one.depth_share:.0%}",
        "" if one.in_view else "cut by the border",
        not one.in_view or one.depth_share < _LEAST_DEPTH_SHARE,
    )


def _attempt(one: Tried) -> Attempt:
    failed = one.score is None
    outcome = one.code if one.score is None else f"{one.score:.2f}"
    return Attempt(one.instance, css_color(one.instance), one.sample + 1, outcome, one.text, failed)


def css_color(number: int) -> str:
    """Return the colour of a thing in the picture."""
    red, green, blue = color_of(number)
    return f"rgb({red}, {green}, {blue})"
