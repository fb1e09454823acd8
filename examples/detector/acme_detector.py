"""A detector of another package: from above, across two sides of a thing with room for the fingers beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from bus.cancel import Cancel
from config.schema import Station
from perception.detectors.base import FoundGrasp, SeenLook, SeenScene

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_SLACK_M, _TABLE_M = 0.004, 0.006
_OFFSETS_M = np.linspace(-0.03, 0.03, 7)


class TongSettings(BaseModel):
    """`[perception.settings]` of the station."""

    model_config = ConfigDict(extra="forbid")
    headings: int = Field(default=18, ge=2, le=180)
    deepest_m: float = Field(default=0.025, gt=0, le=0.045)


class Tongs:
    """Two parallel fingers closed on the points of one thing."""

    Settings = TongSettings
    is_deterministic = True

    def __init__(self, station: Station, settings: TongSettings) -> None:
        self._settings = settings

    def detect(self, seen: SeenScene, cancel: Cancel) -> Sequence[FoundGrasp]:
        """The best grasps of every target."""
        table_from_base: Array = np.linalg.inv(seen.base_from_table).astype(float)
        clouds = [_points(look, table_from_base) for look in seen.looks]
        points, labels = (np.concatenate(parts) for parts in zip(*clouds, strict=True))
        found: list[FoundGrasp] = []
        for number in seen.targets:
            cancel.raise_if_set("detect")
            found += self._of_thing(points, labels == number, number, seen)
        return found

    def close(self) -> None:
        """It holds nothing."""

    def _of_thing(
        self, points: Array, is_ours: npt.NDArray[np.bool_], number: int, seen: SeenScene
    ) -> list[FoundGrasp]:
        ours = points[is_ours]
        if len(ours) < 30:
            return []
        top_m = float(np.percentile(ours[:, 2], 98))
        tip_m = max(top_m - self._settings.deepest_m, top_m / 2)
        middle = ours[:, :2].mean(axis=0)
        near = points[np.linalg.norm(points[:, :2] - middle, axis=1) < 0.15]
        turns = np.arange(self._settings.headings) * np.pi / self._settings.headings
        found = [one for turn in turns for one in self._across(ours, near, (middle, tip_m, float(turn)), number, seen)]
        return sorted(found, key=lambda one: -one.score)[:4]

    def _across(
        self, ours: Array, near: Array, where: tuple[Array, float, float], number: int, seen: SeenScene
    ) -> Iterator[FoundGrasp]:
        """Grasps with one heading of the closing axis, at several places along the thing."""
        middle, tip_m, turn = where
        closing, along = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        at, beside = (ours[:, :2] - middle) @ closing, (ours[:, :2] - middle) @ along
        all_at, all_beside = (near[:, :2] - middle) @ closing, (near[:, :2] - middle) @ along
        half_finger_m = seen.hand.finger_width_m / 2
        for offset_m in _OFFSETS_M:
            held = at[(np.abs(beside - offset_m) < half_finger_m) & (ours[:, 2] > tip_m - 0.01)]
            if len(held) < 10:
                continue
            width_m, center_m = float(np.ptp(held)), float(held.min() + held.max()) / 2
            if not 0.003 < width_m < seen.hand.max_width_m - 2 * _SLACK_M:
                continue
            out = np.abs(all_at - center_m) - width_m / 2
            in_the_way = (np.abs(all_beside - offset_m) < half_finger_m) & (out > _SLACK_M)
            in_the_way &= out < _SLACK_M + seen.hand.finger_thickness_m
            if (near[in_the_way, 2] > max(tip_m - 0.012, _TABLE_M)).any():
                continue
            x, y = middle + center_m * closing + offset_m * along
            pose = np.eye(4)
            pose[:3, 1], pose[:3, 2] = [*closing, 0.0], [0.0, 0.0, -1.0]
            pose[:3, 0], pose[:3, 3] = np.cross(pose[:3, 1], pose[:3, 2]), [x, y, tip_m]
            score = 1.0 - 0.5 * abs(float(offset_m)) / 0.03 - 0.3 * width_m / seen.hand.max_width_m
            yield FoundGrasp(seen.base_from_table @ pose, width_m, max(score, 0.0), number)


def _points(look: SeenLook, table_from_base: Array) -> tuple[Array, npt.NDArray[np.uint8]]:
    """Return what a look measured (n, 3) [m] in the table's frame, and the number (n,) of the thing that each is of."""
    v, u = np.nonzero(np.isfinite(look.depth_m))
    z, camera = look.depth_m[v, u].astype(float), look.camera
    points = np.stack([(u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z], axis=1)
    table_from_camera = table_from_base @ look.base_from_camera
    return points @ table_from_camera[:3, :3].T + table_from_camera[:3, 3], look.labels[v, u]
