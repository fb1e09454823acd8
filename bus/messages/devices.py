"""Camera, arm and hand: their frames, states and motions."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Self

from pydantic import ModelWrapValidatorHandler, model_validator

from bus.arrays import ColorImage, DepthImage, Joints, JointSamples, Samples, Transform
from bus.frozen import Message
from bus.messages.camera_model import CameraModel
from bus.messages.frame_checks import (
    made,
    require_baseline,
    require_lens,
    require_metres,
    require_rgb,
    require_size,
)


class Frame(Message):
    """One synchronised RGB-D capture, raw from the device (depth not registered to colour).

    Attributes:
        stamp_ns: middle of the exposure, UTC.
        color: (H, W, 3) RGB, distorted by ``color_camera``.
        depth_m: (h, w) z-depth in the depth camera, NaN = invalid, distorted by ``depth_camera``. What is 0, negative
            or infinite becomes NaN.
        color_from_depth: (4, 4) pose of the depth camera in the colour camera [m].

    Raises: BadFrame: a field cannot be one of a frame; the text names it, what it is and what it has to be.
    """

    stamp_ns: int
    color: ColorImage
    depth_m: DepthImage
    color_camera: CameraModel
    depth_camera: CameraModel
    color_from_depth: Transform

    @model_validator(mode="wrap")
    @classmethod
    def _require_sound(cls, values: Any, make: ModelWrapValidatorHandler[Self]) -> Self:
        if isinstance(values, dict):
            require_rgb("Frame.color", values.get("color"))
        frame = made("Frame", values, make)
        require_lens("Frame.color_camera", frame.color_camera)
        require_lens("Frame.depth_camera", frame.depth_camera)
        require_size("Frame.color", frame.color, "Frame.color_camera", frame.color_camera)
        require_size("Frame.depth_m", frame.depth_m, "Frame.depth_camera", frame.depth_camera)
        require_baseline("Frame.color_from_depth", frame.color_from_depth)
        require_metres("Frame.depth_m", frame.depth_m)
        return frame


class ArmMode(StrEnum):
    """The arm's operating mode: those of libfranka's RobotMode that the cell reacts to."""

    IDLE = "idle"
    MOVE = "move"
    REFLEX = "reflex"
    USER_STOPPED = "user_stopped"
    OTHER = "other"


class ArmState(Message):
    """Measured state of the arm.

    Attributes:
        stamp_ns: when it was measured, UTC.
        mode: what the arm does, or why it may not move.
        q_rad, dq_rad_s: (n,) joint positions and velocities, base to wrist.
        tau_ext_nm: (n,) external torque on the joints, without gravity.
    """

    stamp_ns: int
    mode: ArmMode
    q_rad: Joints
    dq_rad_s: Joints
    tau_ext_nm: Joints


class Motion(Message):
    """Outcome of one executed trajectory.

    Attributes:
        finished: played to its end; False = a stop, or its guard, braked it on its path.
        commanded_q_rad: (m, n) joint positions as sent to the arm, at 1 kHz.
        t_s, q_rad, dq_rad_s, tau_ext_nm: measured (m,) and (m, n), every 10 ms of robot time from the motion's start.
        contact_n: the force at which its guard (`bus.trajectory.ContactGuard`) braked it; None = it met nothing.
    """

    finished: bool
    commanded_q_rad: JointSamples
    t_s: Samples
    q_rad: JointSamples
    dq_rad_s: JointSamples
    tau_ext_nm: JointSamples
    contact_n: float | None = None


class HandState(Message):
    """Measured state of the parallel hand; ``width_m`` is the distance between the finger pads.

    Attributes:
        stamp_ns: when it was measured, UTC.
        width_m: distance between the finger pads.
        is_moving: the fingers move.
        is_homed: the hand knows its width: it was homed since it was switched on.
        clock_s: the time of the simulation, which is not that of the stamps; None on hardware.
    """

    stamp_ns: int
    width_m: float
    is_moving: bool
    is_homed: bool
    clock_s: float | None = None
