"""Frozen types of every message in the cell.

SI units and radians; frames are named in the fields (``a_from_b`` maps b-coordinates to a); times are integer
nanoseconds UTC. Frames: ``base``, ``flange``, ``hand``, ``tcp`` (z = approach, y = closing axis), ``color`` (the colour
camera, optical: x right, y down, z forward), ``depth``. Definitions: docs/frames.md.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Generic, Literal, TypeVar

from bus.arrays import Blob, ColorImage, DepthImage, Joints, JointSamples, Mask, Points, Samples, Transform, Vector3
from bus.codes import Code
from bus.errors import CycleFailure
from bus.frozen import Message
from bus.lazy import LazyModule
from bus.rejection import Rejection
from bus.trajectory import Trajectory

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
else:
    np = LazyModule("numpy")

# --- camera -----------------------------------------------------------------------------------------------------------


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


# --- arm and hand -----------------------------------------------------------------------------------------------------


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


# --- the cycle's stages -----------------------------------------------------------------------------------------------


class View(Message):
    """The camera pose of one frame. The frame itself travels and is recorded as images, found by its stamp.

    Attributes:
        stamp_ns: of the frame, UTC.
        arm: the arm's state at the capture.
        base_from_color: (4, 4) pose of the colour camera in ``base`` [m].
    """

    stamp_ns: int
    arm: ArmState
    base_from_color: Transform


class Observation(Message):
    """capture: the frame and its camera pose. ``view.stamp_ns == frame.stamp_ns``."""

    view: View
    frame: Frame


class Rectangle(Message):
    """A grasp rectangle in the undistorted colour image (Jiang et al. 2011).

    Attributes:
        center_px: (u, v).
        angle_rad: direction of the closing axis in the image, in [0, pi).
        width_px: jaw opening, along the closing axis (lambda x run).
        height_px: jaw height, across it.
    """

    center_px: tuple[float, float]
    angle_rad: float
    width_px: float
    height_px: float

    def corners_px(self) -> npt.NDArray[np.float64]:
        """Its corners (4, 2) as (u, v), one after the other; the first side lies along the closing axis."""
        along = np.array([np.cos(self.angle_rad), np.sin(self.angle_rad)]) * self.width_px / 2
        across = np.array([-np.sin(self.angle_rad), np.cos(self.angle_rad)]) * self.height_px / 2
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        return np.asarray(np.array(self.center_px) + signs[:, :1] * along + signs[:, 1:] * across)


class Grasp(Message):
    """A 6-DoF grasp for a parallel hand.

    Attributes:
        base_from_tcp: (4, 4) [m]: tcp z = approach direction, tcp y = closing axis, origin between the pads.
        width_m: object width between the pads; ``opening_m``: hand width to approach with.
        score: higher is better; the weighted mean of ``terms``, each named and between 0 and 1.
        rectangle: index of the rectangle it came from.
        imagined_base_from_tcp: (4, 4), the same grasp as the transferred rod gives it, before the snap to the surface.
    """

    base_from_tcp: Transform
    width_m: float
    opening_m: float
    score: float
    rectangle: int
    imagined_base_from_tcp: Transform
    terms: dict[str, float]


class Usage(Message):
    """Token use of one call of a hosted model, as its provider counts it, and its price.

    Attributes:
        cost_usd: price of the call.
        is_complete: the provider reported every figure; else tokens and price are lower bounds.
    """

    input_tokens: int = 0
    output_tokens: int = 0
    reasoning_tokens: int = 0
    cost_usd: float = 0.0
    is_complete: bool = True


class ModelReply(Message):
    """One call of a goal-image model: request and reply. Published as it happens, so that failed calls are kept too.

    Attributes:
        step, sample: place in the imagination stage; ``sample`` counts the proposals from 0.
        model: name of the model. ``prompt``: the complete text sent.
        text: the reply's text. ``image_png``: the reply's image, unchanged.
        failure, text_of_failure: code and reason when no usable reply came; then text and image are empty.
        attempts: how often it was called. ``latency_s``: from the first attempt to the reply.
    """

    step: Literal["locate", "reason", "direct", "render"]
    sample: int = 0
    model: str
    prompt: str
    text: str = ""
    image_png: Blob | None = None
    failure: Code | None = None
    text_of_failure: str = ""
    usage: Usage = Usage()
    attempts: int = 1
    latency_s: float = 0.0


class Drift(Message):
    """How far the goal image departs from the parts it must keep (hosted models treat masks as advisory).

    Attributes:
        changed_outside: share of the background whose colour changed.
        other_objects: area of new other regions, as a share of the object's.
        silhouette_iou: overlap of the imagined object's outline with the observed one, after registration.
        shift_px, turn_rad, scale: that registration.
        color_shift: CIE76 distance of the object's median colours.
    """

    changed_outside: float
    other_objects: float
    silhouette_iou: float
    shift_px: float
    turn_rad: float
    scale: float
    color_shift: float


class Alignment(Message):
    """The transform from the imagined object to the observed one (paper, Algorithm 1, stage 2), and its quality.

    Attributes:
        method: e.g. ``silhouette_3d``.
        observed_from_goal: (4, 4) in the colour frame: rotation x scale and translation [m]; where the method allows
            for it, also a stretch along the goal's optical axis (monocular relief is unreliable).
        scale: its scale.
        chamfer_m2: sum of the two mean squared nearest-neighbour distances after alignment.
        goal_to_observed_m, observed_to_goal_m: the one-way Hausdorff distances.
        residual: two-way mean distance, the worst 15 % left out, as a share of the object's rms radius.
        hypotheses: how many orientations were tried. ``took_s``: wall time.
    """

    method: str
    observed_from_goal: Transform
    scale: float
    chamfer_m2: float
    goal_to_observed_m: float
    observed_to_goal_m: float
    residual: float
    hypotheses: int
    took_s: float


class Evidence(Message):
    """The intermediate results that lead to the grasps, for display and for the report.

    Images are in the undistorted colour image; points in the ``color`` frame [m]. Of several proposals these belong to
    the chosen one.

    Attributes:
        goal_image: I_G on its plain background.
        sample: index of the chosen proposal. ``agreement``: share of the proposals whose rod grasps at the same place
            (their rectangles match as in Jiang et al. 2011); 1 with a single one.
    """

    color: ColorImage
    object_mask: Mask
    goal_image: ColorImage
    goal_object_mask: Mask
    goal_rod_mask: Mask
    observed_points: Points
    goal_points: Points
    aligned_points: Points
    rod_points: Points
    rod_ends: tuple[Vector3, Vector3]
    alignment: Alignment
    drift: Drift
    sample: int
    agreement: float


class Detections(Message):
    """detect: ranked grasps, best first, and the evidence."""

    rectangles: tuple[Rectangle, ...]
    grasps: tuple[Grasp, ...]
    evidence: Evidence


SegmentName = Literal["reach", "carry", "place", "home"]


class Segment(Message):
    """One executable motion of the pick, from rest to rest.

    Attributes:
        name: ``reach`` to the pregrasp and along the approach line, ``carry`` up the lift line and to the viewpoint of
            the second capture, ``place`` above the tray and down, ``home`` up and to the capture pose.
        route: whether its free part is a straight joint line, or was searched for around obstacles.
    """

    name: SegmentName
    route: Literal["straight", "searched"]
    trajectory: Trajectory


class PickPlan(Message):
    """plan: the chosen grasp and every motion of the pick, each checked against limits and collisions.

    Attributes:
        grasp: index of the chosen grasp. ``tilt_rad``: rotation of its approach about the closing axis (the rod).
    """

    grasp: int
    tilt_rad: float
    segments: tuple[Segment, ...]
    rejected: tuple[Rejection, ...]


class SegmentRun(Message):
    """A segment as it was executed.

    Attributes:
        hand: the hand's state after it.
    """

    name: SegmentName | Literal["hold"]
    motion: Motion
    hand: HandState


class Execution(Message):
    """execute: commanded and measured motion, from the start to the end of the hold, and the second capture.

    Attributes:
        runs: the segments in the order they ran, ``hold`` ones included, each with the hand's state after it.
        grasped: the hand's state right after closing; None if it never closed.
        stopped_in: the segment (or hand action) that a stop interrupted or prevented, or None.
        after: the second capture, taken while holding; None if not reached.
    """

    runs: tuple[SegmentRun, ...]
    grasped: HandState | None
    stopped_in: str | None
    after: View | None


class Delivery(Message):
    """deliver: the motions after the verdict: the held object laid into the tray, the arm back home.

    Attributes:
        released: the hand's state after opening; None if not reached.
    """

    runs: tuple[SegmentRun, ...]
    released: HandState | None


class Verdict(Message):
    """verify: whether the object was picked, and the measurements behind it.

    Attributes:
        held: the answer. ``code``: None when held.
        hold_s: how long the hold was observed; ``width_min_m``: smallest hand width meanwhile.
        load_n: mean vertical force of the load on the tcp during the hold, relative to just before the grasp.
        cleared_fraction: share of the object's observed height map that the second capture shows empty.
    """

    held: bool
    code: Code | None
    reason: str
    hold_s: float
    width_min_m: float
    load_n: float
    cleared_fraction: float


# --- the cycle's record -----------------------------------------------------------------------------------------------

StageName = Literal["capture", "detect", "plan", "execute", "verify", "deliver"]
ResultT = TypeVar("ResultT", bound=Message)


class Attempt(Message):
    """The beginning of a cycle: the first try of a pick, or a retry (`cell.daemon.retry`).

    Attributes:
        number: 0 = the first. ``retry_of``: id of the cycle before, "" for the first.
        missed: ``base_from_tcp`` (4, 4) of grasps that closed on nothing in earlier cycles; planning leaves them out.
    """

    cycle_id: str
    number: int = 0
    retry_of: str = ""
    missed: tuple[Transform, ...] = ()


class Failure(Message):
    """Why a stage ended the cycle. ``rejected``: from the plan stage, every way to grasp that is not feasible."""

    code: Code
    text: str
    rejected: tuple[Rejection, ...] = ()

    @classmethod
    def of(cls, error: CycleFailure) -> Failure:
        """Make the message from the error that a stage raised."""
        return cls(code=error.failure, text=error.text, rejected=tuple(error.rejected))


class StageRecord(Message, Generic[ResultT]):
    """Record of one stage of one cycle, published and recorded under ``cycle/{stage}``.

    Exactly one of ``result`` and ``failure`` is set.

    Attributes:
        started_ns: UTC.
        duration_s: wall time.
    """

    cycle_id: str
    stage: StageName
    started_ns: int
    duration_s: float
    result: ResultT | None
    failure: Failure | None


class CycleResult(Message):
    """How one cycle ended.

    Attributes:
        object: name of the presented object in simulation, "" on hardware.
        stages: wall time of each stage that ran [s].
        recording: path of the MCAP.
        retried_as: id of the cycle that tries again; "" when this one was the last.
    """

    cycle_id: str
    object: str
    result: Literal["SUCCESS", "FAILED", "ABORTED", "EMPTY"]
    code: Code | None
    reason: str
    stages: dict[str, float]
    wall_s: float
    recording: str
    retried_as: str = ""
