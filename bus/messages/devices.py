"""Camera, arm and hand: their frames, states and motions."""

from __future__ import annotations

from enum import StrEnum

from bus.arrays import ColorImage, DepthImage, Joints, JointSamples, Samples, Transform
from bus.frozen import Message


class CameraModel(Message):
    """A pinhole camera with OpenCV's rational distortion (Brown-Conrady K6 on the Femto Mega; docs/frames.md).

    Attributes:
        width, height: image size [px].
        fx, fy, cx, cy: intrinsics [px], pixel centres at integers.
        distortion: (k1, k2, p1, p2, k3, k4, k5, k6), or empty for none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()


class Frame(Message):
    """One synchronised RGB-D capture, raw from the device (depth not registered to colour).

    Attributes:
        stamp_ns: middle of the exposure, UTC.
        color: (H, W, 3) RGB, distorted by ``color_camera``.
        depth_m: (h, w) z-depth in the depth camera, NaN = invalid, distorted by ``depth_camera``.
        color_from_depth: (4, 4) pose of the depth camera in the colour camera [m].
    """

    stamp_ns: int
    color: ColorImage
    depth_m: DepthImage
    color_camera: CameraModel
    depth_camera: CameraModel
    color_from_depth: Transform


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
        q_rad, dq_rad_s: (7,) joint positions and velocities, base to wrist.
        tau_ext_nm: (7,) external torque on the joints, without gravity.
    """

    stamp_ns: int
    mode: ArmMode
    q_rad: Joints
    dq_rad_s: Joints
    tau_ext_nm: Joints


class Motion(Message):
    """Outcome of one executed trajectory.

    Attributes:
        finished: played to its end; False = a stop braked it on its path.
        commanded_q_rad: (n, 7) joint positions as sent to the arm, at 1 kHz.
        t_s, q_rad, dq_rad_s, tau_ext_nm: measured (m,) and (m, 7), every 10 ms of robot time from the motion's start.
    """

    finished: bool
    commanded_q_rad: JointSamples
    t_s: Samples
    q_rad: JointSamples
    dq_rad_s: JointSamples
    tau_ext_nm: JointSamples


class HandState(Message):
    """Measured state of the parallel hand; ``width_m`` is the distance between the finger pads."""

    stamp_ns: int
    width_m: float
    is_moving: bool
    is_homed: bool
