"""The space that the hand sweeps on its straight way to a grasp, and what it meets there.

All in the grasp's own frame: x across the finger, y the closing axis, z up against the approach, the origin between the
finger tips. In metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.heaps.clipping import Solid, box_near
from benchmarks.heaps.heap import FIXED
from benchmarks.heaps.shapes import box_corners
from bus.transforms import apply, from_rotation, from_translation, inverse
from config.devices import CameraSettings, HandSettings
from config.franka_hand import FINGER_TIP_M, HAND_FROM_TCP_M, PALM_ABOVE_TIP_M
from planning.robot import CAMERA_SIZE_M, hand_from_color

PALM_SIZE_M = (0.064, 0.200)
"""Of the hand's body, across the fingers and along the closing axis (collision mesh, rounded up)."""
_OVER_TABLE_M = 0.0005
_FINGER_STEP_M, _PALM_STEP_M = 0.001, 0.002
_FAR_M = 10.0
_BEHIND_M = 0.3
"""Length of the hand, and of its way there: so far behind the tips the table must not come up beside it."""
_LENS_BEHIND_M = 0.005
"""Of the wrist camera: how far its colour frame lies behind the front of its housing."""

Array = npt.NDArray[np.float64]

TCP_FROM_GRASP = from_rotation(np.diag([-1.0, 1.0, -1.0]), (0.0, 0.0, FINGER_TIP_M))


class Hand:
    """The open hand with its camera.

    Args:
        hand: gives the fingers' width and thickness.
        camera: gives its place on the hand.
    """

    def __init__(self, hand: HandSettings, camera: CameraSettings) -> None:
        self._hand, self._camera = hand, _housing(camera)

    def reach(self, half_m: float) -> tuple[Array, Array]:
        """The box (2 x (3,)) outside of which nothing matters at half an opening; open above."""
        camera_m = np.abs([self._camera.x_m, self._camera.y_m]).max(axis=1)
        x_m = max(PALM_SIZE_M[0] / 2, camera_m[0])
        y_m = max(PALM_SIZE_M[1] / 2, half_m + self._hand.finger_thickness_m, camera_m[1])
        return np.array([-x_m, -y_m, 0.0]), np.array([x_m, y_m, _FAR_M])

    def hit(self, near: Sequence[tuple[int, Solid]], grasp_from_table: Array, half_m: float) -> str:
        """Return what the hand meets on its way, "" for nothing. It has no front: its camera may be on either side.

        Args:
            near: bodies and their parts. ``half_m``: half the opening.
        """
        x_m, outer_m = self._hand.finger_width_m / 2, half_m + self._hand.finger_thickness_m
        palm_m = (PALM_SIZE_M[0] / 2, PALM_SIZE_M[1] / 2)
        feet = (
            _Foot("finger", (-x_m, x_m), (-outer_m, -half_m), 0.0, _FINGER_STEP_M),
            _Foot("finger", (-x_m, x_m), (half_m, outer_m), 0.0, _FINGER_STEP_M),
            _Foot("palm", (-palm_m[0], palm_m[0]), (-palm_m[1], palm_m[1]), PALM_ABOVE_TIP_M, _PALM_STEP_M),
        )
        for foot in feet:
            if hit := foot.met(near, grasp_from_table):
                return hit
        sides = [side.met(near, grasp_from_table) for side in (self._camera, self._camera.turned())]
        return sides[0] if all(sides) else ""


@dataclass(frozen=True)
class _Foot:
    """A level rectangle of the hand: all above it, as far as the hand came from, must be free."""

    name: str
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    bottom_m: float
    step_m: float

    def turned(self) -> _Foot:
        """Return it with the hand half a turn about its approach."""
        return replace(self, x_m=(-self.x_m[1], -self.x_m[0]), y_m=(-self.y_m[1], -self.y_m[0]))

    def met(self, near: Sequence[tuple[int, Solid]], grasp_from_table: Array) -> str:
        """Return what stands over the foot and reaches its bottom; "" for nothing."""
        if self._in_table(grasp_from_table):
            return f"{self.name} in the table"
        lines = self._lines()
        low, high = np.array([*lines.min(axis=0)[:2], self.bottom_m]), np.array([*lines.max(axis=0)[:2], _FAR_M])
        for body, solid in near:
            if box_near(solid, low, high) and solid.clip(lines, 2).leave.max() > self.bottom_m:
                return f"{self.name} in {'a wall' if body == FIXED else f'body {body}'}"
        return ""

    def _in_table(self, grasp_from_table: Array) -> bool:
        """Whether the foot, or what is behind it, comes nearer to the table than the clearance."""
        up, on_table = grasp_from_table[:3, 2], grasp_from_table[:3, 3]
        ends_m = (self.bottom_m, self.bottom_m + _BEHIND_M)
        corners = np.array([[x, y, z] for x in self.x_m for y in self.y_m for z in ends_m])
        return bool(((corners - on_table) @ up).min() < _OVER_TABLE_M)

    def _lines(self) -> Array:
        """Return points (m, 3) at z = 0 all over the rectangle, its edges included."""
        sides = [np.linspace(*ends, round((ends[1] - ends[0]) / self.step_m) + 1) for ends in (self.x_m, self.y_m)]
        x, y = (one.ravel() for one in np.meshgrid(*sides, indexing="ij"))
        return np.stack([x, y, np.zeros(x.size)], axis=1)


def _housing(camera: CameraSettings) -> _Foot:
    """The front of the wrist camera's housing, as a box along the grasp's axes."""
    size_m = np.array(CAMERA_SIZE_M)
    corners = box_corners(size_m, np.array([0.0, 0.0, _LENS_BEHIND_M - size_m[2] / 2]))
    tcp_from_color = inverse(from_translation((0.0, 0.0, HAND_FROM_TCP_M))) @ hand_from_color(camera)
    corners = apply(inverse(TCP_FROM_GRASP) @ tcp_from_color, corners)
    (x_min, y_min, bottom_m), (x_max, y_max, _) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return _Foot("camera", (x_min, x_max), (y_min, y_max), bottom_m, _PALM_STEP_M)
