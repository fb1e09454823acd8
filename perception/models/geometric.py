"""The embedded goal-image model: it reasons from depth and silhouette, and paints the rod itself.

No network, no training, no randomness; one instance works on one subject at a time.
"""

from __future__ import annotations

import re

import cv2
import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from config.schema import Station
from perception import antipodal
from perception.heightmap import height_map
from perception.lift import inverse, project, transform
from perception.models.base import GoalImage, Subject

_STICK_OUT_M = 0.035
_COVER_M = 0.002
_HIDING_M = 0.003
"""A surface hides the rod also when it seems to lie this little behind it: depth is noisy."""
_LIGHT = np.array([-0.35, -0.45, -0.82])  # towards the light, camera frame
_NUMBER = r"(-?\d+\.\d+)"
_AXIS = re.compile(rf"from \({_NUMBER}, {_NUMBER}, {_NUMBER}\) to \({_NUMBER}, {_NUMBER}, {_NUMBER}\)")

Array = npt.NDArray[np.float64]


class GeometricModel:
    """Antipodal reasoning on the observed height map, and a shaded cylinder where it leads."""

    name = "geometric"

    def __init__(self, station: Station) -> None:
        self._station = station

    def reason(self, subject: Subject, prompt: str) -> str:
        """The best antipodal axis, in words. Raises: CycleFailure(NO_GRASP)."""
        heights = height_map(subject.scene)
        closings = antipodal.propose(heights, self._station)
        if not len(closings.score) or not np.isfinite(closings.score.max()):
            raise CycleFailure(Code.NO_GRASP, "No two opposite faces fit the jaw and can be reached from above.")
        best = closings.best()
        heading = closings.heading_rad[best]
        half = (closings.width_m[best] / 2 + _STICK_OUT_M) * np.array([np.cos(heading), np.sin(heading), 0.0])
        # The rod runs at the height of the contacts, inside the object, but not so low that it sinks into the table.
        radius_m = self._station.perception.rod_radius_m
        level_m = max(min(closings.tcp_m[best], closings.edge_m[best] - radius_m - _COVER_M), radius_m + _COVER_M / 2)
        center = np.append(closings.center_m[best], level_m)
        start, end = (", ".join(f"{value:.4f}" for value in center + side * half) for side in (-1, 1))
        return (
            f"The object is {subject.scene.height_m[subject.scene.object_mask].max() * 1e3:.0f} mm high. Two opposite "
            f"faces {closings.width_m[best] * 1e3:.1f} mm apart fit the jaw; of {np.isfinite(closings.score).sum()} "
            f"feasible axes this one scores best ({closings.score[best]:.2f}). In the robot's base frame, in metres, "
            f"the axis runs from ({start}) to ({end})."
        )

    def direct(self, reasoning: str, prompt: str) -> str:
        """The axis as an editing instruction."""
        axis = _AXIS.search(reasoning)
        if axis is None:
            raise CycleFailure(Code.MODEL_REFUSED, "The reasoning names no axis.")
        return f"Draw a straight cylinder {axis.group(0)} (base frame, metres) through the object."

    def render(self, subject: Subject, directive: str, prompt: str) -> GoalImage:
        """Paint the rod; what the object hides stays hidden."""
        axis = _AXIS.search(directive)
        if axis is None:
            raise CycleFailure(Code.MODEL_REFUSED, "The directive names no axis.")
        ends_base = np.array([float(value) for value in axis.groups()]).reshape(2, 3)
        ends = transform(inverse(subject.base_from_color), ends_base)
        return _paint(subject, ends, self._station.perception.rod_radius_m)


def _paint(subject: Subject, ends: Array, radius_m: float) -> GoalImage:
    """Ray-cast a cylinder with flat ends, z-buffered against what was observed."""
    observed_m = _filled(subject)
    depth_m, normals = _cylinder(ends, radius_m, subject)
    visible = np.isfinite(depth_m) & ~(observed_m < depth_m + _HIDING_M)
    light = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    shade = np.clip(0.35 + 0.65 * light, 0, 1)[..., None] + 0.25 * (light**12)[..., None]
    rod = np.clip(np.array(subject.rod.rgb) * shade, 0, 255)
    image = np.where(visible[..., None], rod, subject.rgbd.color).astype(np.uint8)
    goal_depth_m = np.where(visible, depth_m, subject.rgbd.depth_m).astype(np.float32)
    return GoalImage(image, goal_depth_m)


def _filled(subject: Subject) -> npt.NDArray[np.float32]:
    """Observed depth of the object with its pinholes closed by the nearest surface beside them; NaN elsewhere."""
    observed = np.where(subject.scene.object_mask, subject.rgbd.depth_m, np.inf).astype(np.float32)
    closed = cv2.erode(cv2.dilate(-observed, np.ones((5, 5))), np.ones((5, 5)))
    return np.where(np.isinf(closed), np.nan, -closed).astype(np.float32)


def _cylinder(ends: Array, radius_m: float, subject: Subject) -> tuple[Array, Array]:
    """Z-depth (H, W) of the cylinder's near surface in the camera, NaN beside it; and its normals (H, W, 3)."""
    camera = subject.rgbd.camera
    along = ends[1] - ends[0]
    length_m = float(np.linalg.norm(along))
    along = along / length_m
    depth_m = np.full((camera.height, camera.width), np.nan)
    normals = np.zeros((camera.height, camera.width, 3))
    box = project(ends, camera)
    pad = 2 * radius_m / float(ends[:, 2].min()) * camera.fx + 2
    u0, v0 = np.maximum(np.floor(box.min(axis=0) - pad), 0).astype(int)
    u1, v1 = np.minimum(np.ceil(box.max(axis=0) + pad), [camera.width - 1, camera.height - 1]).astype(int)
    u, v = np.meshgrid(np.arange(u0, u1 + 1), np.arange(v0, v1 + 1))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    # |(ray z - end) - along ((ray z - end) . along)| = radius, for the smaller z
    across = rays - (rays @ along)[..., None] * along
    offset = ends[0] - along * (ends[0] @ along)
    a, b, c = (across**2).sum(-1), across @ offset, offset @ offset - radius_m**2
    root = b**2 - a * c
    z = (b - np.sqrt(np.maximum(root, 0))) / a
    points = rays * z[..., None]
    position = (points - ends[0]) @ along
    hit = (root > 0) & (position >= 0) & (position <= length_m)
    depth_m[v0 : v1 + 1, u0 : u1 + 1] = np.where(hit, z, np.nan)
    normals[v0 : v1 + 1, u0 : u1 + 1] = (points - ends[0] - position[..., None] * along) / radius_m
    return depth_m, normals
