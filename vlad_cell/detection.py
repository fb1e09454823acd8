"""Grasps in one saved RGB-D image: ``detect``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections as Record
from bus.messages import Instance, Rectangle
from logs.report.evidence import Choice
from logs.report.images import annotated, crop
from perception.detector import detect as vlad_grasp
from perception.detector import ignore_reply
from perception.models import open_models
from vlad_cell.advice import FOR_AN_IMAGE
from vlad_cell.arguments import observed
from vlad_cell.in_view import another_meant, require_in_view
from vlad_cell.picture import Picture
from vlad_cell.station import Config, Settings, station_of


@dataclass(frozen=True, eq=False)
class Grasp:
    """One grasp of a hand with two parallel fingers.

    Attributes:
        base_from_grasp: (4, 4) float64, metres: z = the direction of approach, y = the closing axis, the origin between
            the finger pads.
        width_m: width of the object between the pads.
        opening_m: width of the hand to come with.
        score: 0 to 1, higher is better.
        thing: number of the object it holds, as in `Detections.labels`.
        rectangle: the grasp in the colour image: ``center_px``, ``angle_rad``, ``width_px``, ``height_px``, and
            ``corners_px()`` (4, 2) as (u, v).
        terms: what the score is made of, by name, each 0 to 1 (docs/method.md).
    """

    base_from_grasp: npt.NDArray[np.float64]
    width_m: float
    opening_m: float
    score: float
    thing: int
    rectangle: Rectangle
    terms: Mapping[str, float]

    def __repr__(self) -> str:
        x_m, y_m, z_m = self.base_from_grasp[:3, 3]
        at = f"({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m"
        return f"Grasp of thing {self.thing}, score {self.score:.2f}, {self.width_m * 1e3:.0f} mm wide, at {at}"


@dataclass(frozen=True, eq=False)
class Detections:
    """The findings in one image.

    Attributes:
        record: the whole record of the detection, as a recording holds it: the seen table, the masks, the point clouds,
            and everything that was tried (docs/bus.md).
    """

    record: Record

    def __repr__(self) -> str:
        scores = [one.score for one in self.record.grasps]
        best = f", the best of score {max(scores):.2f}" if scores else ""
        return f"Detections: {counted(len(scores), 'grasp')}{best}, of {counted(len(self.things), 'thing')}"

    @property
    def grasps(self) -> tuple[Grasp, ...]:
        """The grasps, the best first; there is at least one."""
        return tuple(
            Grasp(
                base_from_grasp=one.base_from_tcp,
                width_m=one.width_m,
                opening_m=one.opening_m,
                score=one.score,
                thing=one.instance,
                rectangle=self.record.rectangles[one.rectangle],
                terms=one.terms,
            )
            for one in self.record.grasps
        )

    @property
    def things(self) -> tuple[Instance, ...]:
        """The objects that were told apart: ``number``, ``top_m`` (3,) in ``base``, ``size_m`` (3,)."""
        return self.record.scene.instances

    @property
    def labels(self) -> npt.NDArray[np.uint8]:
        """(H, W) the number of the object in each pixel, 0 = none."""
        return self.record.scene.labels

    @property
    def goal_image(self) -> npt.NDArray[np.uint8]:
        """(H, W, 3) RGB: the object with the imagined rod through it, of the best grasp."""
        return self.record.evidence.goal_image

    def picture(self, *, close_up: bool = False) -> Picture:
        """Return the colour image with the object's outline and the grasps' rectangles, that of the best one in yellow.

        Args:
            close_up: only the part around the object.
        """
        return drawn(self.record, Choice(0, ()), close_up=close_up)


_OF_A_POSE = frozenset({Code.NO_TABLE, Code.TABLE_MOVED, Code.NOT_SEEN, Code.TOO_NEAR})
"""Ends of a detection to which a wrong pose of the camera may lead."""


def detect(
    color: npt.ArrayLike,
    depth_m: npt.ArrayLike,
    K: npt.ArrayLike,
    base_from_camera: npt.ArrayLike,
    *,
    region_m: Sequence[float] | None = None,
    distortion: Sequence[float] = (),
    config: Config = None,
    settings: Settings | None = None,
) -> Detections:
    """Find grasps in one RGB-D image. Nothing moves, no cell needs to run, and no network is used.

    The objects lie on a table, the plane z = 0 of ``base``, inside the pick region. ``base`` is any frame that you
    choose so: that of your robot, or the middle of your table with z up.

    Args:
        color: (H, W, 3) uint8, RGB; what OpenCV reads is BGR: ``color[..., ::-1]``.
        depth_m: (H, W) depth along the optical axis in metres, in the same pixels as ``color``; 0 or NaN where nothing
            was measured.
        K: (3, 3) intrinsics of the camera, or (4,) as fx, fy, cx, cy; in pixels of this picture.
        base_from_camera: (4, 4) pose of the camera in ``base``, in metres; optical frame: x right, y down, z forward.
            The camera is above the table and sees something of the pick region.
        region_m: where objects are looked for: x_min, x_max, y_min, y_max in ``base``, in metres; None = the station's.
        distortion: OpenCV's coefficients of the lens (0, 4, 5, 8, 12 or 14 of them); leave it out for an undistorted
            image. Colour and depth have the same.
        config: a station, or the path of its file: hand, table, detector, models; None = the simulated cell, whose
            embedded model needs no network.
        settings: single settings by their full names, as ``{"hand.max_width_m": 0.05}``; docs/settings.md has all.

    Returns:
        The grasps, the best first, with their evidence.

    Raises:
        BadFrame: an argument cannot be; the text names it and says what was received, and what to pass instead.
        CycleFailure: there is no grasp; ``code`` says why (NO_OBJECT, NO_GRASP, TABLE_MOVED, NOT_SEEN, ...).
        ConfigError: a setting is wrong, or a model is not there.
    """
    station = station_of(config, settings, {"region_m": ("scene.pick_region_m", region_m)})
    observation = observed(color, depth_m, K, base_from_camera, distortion)
    require_in_view(observation, station)
    with closing(open_models(station, os.environ)) as models:
        try:
            return Detections(vlad_grasp(observation, station, models, ignore_reply))
        except CycleFailure as failure:
            meant = another_meant(observation, station) if failure.failure in _OF_A_POSE else ""
            failure.advice = f"{meant} {FOR_AN_IMAGE.get(failure.failure, failure.advice)}".strip()
            raise


def drawn(record: Record, chosen: Choice, *, close_up: bool) -> Picture:
    """Return the colour image, or the part of it around the object, with the grasps: chosen, rejected, others."""
    image = annotated(record, *chosen)
    return Picture(crop(image, record.evidence.object_mask) if close_up else image)


def counted(number: int, what: str) -> str:
    """A number of things, in words: ``1 grasp``, ``4 grasps``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
