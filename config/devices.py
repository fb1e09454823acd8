"""Settings of nodes, which drive devices, and of the devices themselves: camera, arm, hand."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from config.base import (
    Fraction,
    JawSize,
    JawSizeOrNone,
    JointVector,
    NoBoolean,
    Positive,
    Seconds,
    Settings,
    SizeOrNone,
    UnitQuaternion,
    Vector,
    wrong,
)


class NodeSettings(Settings):
    """A driver node: its driver, the devices it serves, and whether the daemon runs it.

    Attributes:
        driver: `cell drivers` lists those there are. ``settings``: of another package's driver, which checks them
            itself, in its node.
        run: the daemon starts the node ``here``, or it is started ``elsewhere`` with `cell node`, on any machine.
        serves: the devices that it drives.
    """

    driver: str
    run: Literal["here", "elsewhere"] = "here"
    serves: tuple[Literal["camera", "arm", "hand"], ...]
    settings: dict[str, Any] = Field(default_factory=dict)


class CameraSettings(Settings):
    """Mounting of the wrist camera: pose of the colour camera (optical) in the hand frame.

    Rotation as unit quaternion wxyz. The default looks along the hand's approach axis, image down = hand -x.

    Attributes:
        hand_from_color_position_m: where the colour camera is; `cell calibrate hand-eye` measures it.
        hand_from_color_wxyz: how it is turned.
        max_age_s: a frame older than this is refused (STALE_FRAME).
        least_range_m: the depth camera measures nothing nearer; a hole in its depth may be that. 0.5: Femto Mega, NFOV.
    """

    hand_from_color_position_m: Vector = (0.065, 0.0, 0.02)
    hand_from_color_wxyz: UnitQuaternion = (0.70710678118654752, 0.0, 0.0, 0.70710678118654752)
    max_age_s: Seconds = 2.0
    least_range_m: SizeOrNone = 0.5


class CaptureSettings(Settings):
    """Captures: how often the scene is looked at before a pick.

    Attributes:
        views: 1, 2 or 3 looks, fewer where no other place is reached; ``auto`` looks again only when too little was
            seen, nothing can be grasped, the best grasp is weak, or no way to it is free.
        most_views: most looks of ``auto``.
        weak_score: a best grasp that scores less is worth another look.
        mount_correction: several looks are made to agree by one correction of the camera's mounting.
    """

    views: Annotated[Literal[1, 2, 3, "auto"], NoBoolean] = "auto"
    most_views: Annotated[int, Field(ge=1, le=5)] = 3
    weak_score: Fraction = 0.75
    mount_correction: bool = True


class ArmSettings(Settings):
    """Named joint configurations [rad] and the arm's motion limits.

    Attributes:
        capture_q_rad: the pose of the first look, from which the whole pick region is in the picture.
        speed: share of the allowed joint speed, in 0..1.
        start_tolerance_rad: largest distance of a trajectory's start from the measured position.
        rest_s: longest time for a stopped or held arm, and the cycle that moved it, to come to rest.
    """

    capture_q_rad: JointVector = (0.0, -0.45383069, 0.0, -1.83384904, 0.0, 1.38001835, 0.7853981633974483)
    speed: Annotated[float, Field(gt=0, le=1)] = 1.0
    start_tolerance_rad: Annotated[Positive, Field(le=1)] = 0.02
    rest_s: Seconds = 20.0


class HandSettings(Settings):
    """The Panda hand, and its grasp force. The geometry of its fingers is that of the collision mesh."""

    max_width_m: JawSize = 0.08
    """How far the hand opens, from pad to pad."""
    max_speed_m_s: Positive = 0.1
    """Highest rate of the width: 50 mm/s for each finger (Franka Hand product manual)."""
    max_force_n: Positive = 70.0
    """Highest continuous grasping force (Franka Hand product manual)."""
    speed_m_s: Positive = 0.05
    """Rate of the width while the fingers close on an object; free of it they move at `max_speed_m_s`."""
    grasp_force_n: Positive = 30.0
    """With it the fingers close on an object; a job may ask for less."""
    release_margin_m: JawSize = 0.010
    """How much wider than the object the fingers open to let it go; never less than they came with."""
    finger_width_m: JawSize = 0.020
    """Width of a pad, across the closing axis."""
    finger_thickness_m: JawSize = 0.012
    """Thickness of a finger along the closing axis: the free space that it needs beside an object."""
    min_width_m: JawSizeOrNone = 0.002
    """A thinner thing is no grasp: the fingers would close on nothing."""

    @model_validator(mode="after")
    def _asks_for_what_it_can(self) -> HandSettings:
        if self.speed_m_s > self.max_speed_m_s:
            raise wrong("speed_m_s", f"must be within max_speed_m_s, {self.max_speed_m_s:g}")
        if self.grasp_force_n > self.max_force_n:
            raise wrong("grasp_force_n", f"must be within max_force_n, {self.max_force_n:g}")
        if self.min_width_m >= self.max_width_m:
            raise wrong("min_width_m", f"must be below max_width_m, {self.max_width_m:g}")
        return self
