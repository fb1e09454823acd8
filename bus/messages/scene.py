"""The scene as detect saw it before it looked for grasps: the table, the things on it, and what was not seen."""

from __future__ import annotations

from typing import Literal

from bus.arrays import LabelImage, Mask, Transform, Vector3
from bus.frozen import Message


class SeenTable(Message):
    """The table as it was seen.

    Attributes:
        base_from_table: (4, 4): z along the plane's normal.
        offset_m: its height over the station's table, at the middle of the pick region.
        tilt_rad: angle between it and the station's table, which is level.
    """

    base_from_table: Transform
    offset_m: float
    tilt_rad: float


class SeenMount(Message):
    """The difference of the camera's mounting from the station's, from the disagreement of several looks.

    Attributes:
        turn_deviation_rad, shift_deviation_m: those standard deviations.
        color_from_corrected: (4, 4) what was used: ``base_from_color @ color_from_corrected`` is the better pose of
            each look; the identity where none was used.
        turn_rad, shift_m: of the mounting, as found; with one standard deviation over all directions.
        residual_before_m, residual_after_m: median distance between the looks' surfaces; None = nothing in common.
        is_cut: the looks ask for more than is believed of a calibrated mounting.
        named: what is off, by the planes that the looks show: ``table``, ``mount``, or "" for neither.
        table_tilt_rad: by those planes. ``off_mounting``: turn and shift of the mounting by them, in standard
            deviations of a calibrated one.
    """

    color_from_corrected: Transform
    turn_rad: float
    turn_deviation_rad: float
    shift_m: float
    shift_deviation_m: float
    residual_before_m: float | None
    residual_after_m: float | None
    is_cut: bool
    named: Literal["table", "mount", ""]
    table_tilt_rad: float
    off_mounting: float


class Instance(Message):
    """One thing on the table.

    Attributes:
        number: its value in `ObservedScene.labels`, from 1 on.
        top_m: (3,) its highest point in ``base``. ``size_m``: (3,) length, width and height of the box around it.
        in_view: false when the image's border cuts it.
        depth_share: share of its pixels that have depth; what has its colour and none, beside it, counts as missing.
    """

    number: int
    top_m: Vector3
    size_m: Vector3
    in_view: bool
    depth_share: float


class ObservedScene(Message):
    """The model of the scene. Images are in the undistorted colour image of the look that is shown.

    Attributes:
        table: as it was seen.
        instances: the things on it.
        region_seen: share of the pick region where the table or something on it was seen.
        labels: (H, W) the number of the thing in each pixel, 0 = none.
        unseen: (H, W) the pixels of the pick region without depth.
        shown: index of the look that models and people are shown, among the observations in order.
        further_labels: of every other look, in order, the numbers in its own image.
        mount: how the looks disagree; None for a single one.
    """

    table: SeenTable
    region_seen: float
    instances: tuple[Instance, ...]
    labels: LabelImage
    unseen: Mask
    shown: int = 0
    further_labels: tuple[LabelImage, ...] = ()
    mount: SeenMount | None = None

    @property
    def look_labels(self) -> tuple[LabelImage, ...]:
        """The numbers in the image of every look, in order."""
        return (*self.further_labels[: self.shown], self.labels, *self.further_labels[self.shown :])


class Tried(Message):
    """One rod that was imagined, and what became of it.

    Attributes:
        instance: number of the thing; ``sample``: of the proposal, from 0.
        score: of its best grasp; None with a failure.
        code: the kind of that failure. ``text``: what happened.
    """

    instance: int
    sample: int
    score: float | None = None
    code: str = ""
    text: str = ""
