"""Frozen types of everything that is said in the cell.

SI units and radians; frames are named in the fields (``a_from_b`` maps b-coordinates to a); times are integer
nanoseconds UTC. Frames: ``base``, ``flange``, ``hand``, ``tcp`` (z = approach, y = closing axis), ``color`` (the colour
camera, optical: x right, y down, z forward), ``depth``.
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
    """A pinhole with OpenCV's rational distortion (Brown-Conrady K6 on the Femto Mega).

    Attributes:
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
    """One synchronised RGB-D capture, raw as the device gave it (depth not registered to colour).

    Attributes:
        stamp_ns: middle of the exposure, UTC.
        color: (H, W, 3) RGB, distorted by ``color_camera``.
        depth_m: (h, w) z-depth in the depth camera, NaN = invalid, distorted by ``depth_camera``.
        color_from_depth: pose of the depth camera in the colour camera.
    """

    stamp_ns: int
    color: ColorImage
    depth_m: DepthImage
    color_camera: CameraModel
    depth_camera: CameraModel
    color_from_depth: Transform


# --- arm and hand -----------------------------------------------------------------------------------------------------


class ArmMode(StrEnum):
    """What the arm says it is doing (libfranka RobotMode, the ones we act on)."""

    IDLE = "idle"
    MOVE = "move"
    REFLEX = "reflex"
    USER_STOPPED = "user_stopped"
    OTHER = "other"


class ArmState(Message):
    """Measured state; ``tau_ext_nm`` is the torque that the outside world puts on the joints (gravity-free)."""

    stamp_ns: int
    mode: ArmMode
    q_rad: Joints
    dq_rad_s: Joints
    tau_ext_nm: Joints


class Motion(Message):
    """What became of one executed trajectory.

    Attributes:
        finished: played to its end; False = braked on its path by a stop.
        commanded_q_rad: (n, 7) what was really sent, at 1 kHz.
        t_s, q_rad, dq_rad_s, tau_ext_nm: measured, every 10 ms of robot time from the start of the motion.
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
    """From where a frame was taken; the frame itself travels and is recorded as images, found by its stamp."""

    stamp_ns: int
    arm: ArmState
    base_from_color: Transform


class Observation(Message):
    """capture: what was seen, and from where. ``view.stamp_ns == frame.stamp_ns``."""

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
        base_from_tcp: tcp z = approach direction, tcp y = closing axis, origin between the pads.
        width_m: object width between the pads; ``opening_m``: hand width to approach with.
        score: higher is better; the weighted mean of ``terms``, each named and between 0 and 1.
        rectangle: index of the rectangle it came from.
        imagined_base_from_tcp: the same grasp exactly where the carried rod put it, before the snap to the surface.
    """

    base_from_tcp: Transform
    width_m: float
    opening_m: float
    score: float
    rectangle: int
    imagined_base_from_tcp: Transform
    terms: dict[str, float]


class Usage(Message):
    """What one call of a hosted model took: tokens as its provider counts them, and their price.

    Attributes:
        is_complete: whether it told them all; else tokens and price are what is known, at least.
    """

    input_tokens: int = 0
    output_tokens: int = 0
    reasoning_tokens: int = 0
    cost_usd: float = 0.0
    is_complete: bool = True


class ModelReply(Message):
    """One call of a goal-image model: what was asked, what came back. Said as it happens, so failed calls are kept too.

    Attributes:
        step, sample: where in the imagining; ``sample`` counts the proposals from 0.
        model: the name it was asked by. ``prompt``: all of the text.
        text: what it said. ``image_png``: what it drew, exactly as it came.
        failure, text_of_failure: the code and the reason when no usable answer came; then text and image are empty.
        attempts: how often it was asked. ``latency_s``: from the first attempt to the answer.
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
    """How far the goal image departs from what it should have kept (masks are advisory for every hosted model).

    Attributes:
        changed_outside: share of the background whose colour changed.
        other_objects: area of what else appeared, as a share of the object's.
        silhouette_iou: overlap of the imagined object's outline, laid on the observed one.
        shift_px, turn_rad, scale: how that outline had moved.
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
    """How the imagined object was carried back onto the observed one (paper, Algorithm 1, stage 2).

    Attributes:
        method: e.g. ``silhouette_3d``.
        observed_from_goal: in the colour frame: rotation x scale and translation; where the method allows for it,
            also a stretch along the goal's optical axis (monocular relief is unreliable).
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
    """Why the grasps are what they are: everything a person wants to look at.

    Images are in the undistorted colour image; points in the ``color`` frame. Of several proposals these are the chosen
    one's.

    Attributes:
        goal_image: I_G on its plain background.
        sample: which proposal was chosen. ``agreement``: share of the proposals whose rod grasps at the same place
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
        name: ``reach`` to before the object and along the approach line, ``carry`` up the lift line and to where it is
            looked at again, ``place`` above the tray and down, ``home`` up and to the capture pose.
        route: its free part is a straight joint line, or was searched for around obstacles.
    """

    name: SegmentName
    route: Literal["straight", "searched"]
    trajectory: Trajectory


class PickPlan(Message):
    """plan: the chosen grasp and every motion of the pick, each checked against limits and collisions.

    Attributes:
        grasp: its index. ``tilt_rad``: how far its approach was turned about the closing axis (the rod).
    """

    grasp: int
    tilt_rad: float
    segments: tuple[Segment, ...]
    rejected: tuple[Rejection, ...]


class SegmentRun(Message):
    """A segment as it was executed."""

    name: SegmentName | Literal["hold"]
    motion: Motion
    hand: HandState


class Execution(Message):
    """execute: commanded and measured, from the first motion to the end of the hold, and what was seen then.

    Attributes:
        runs: the segments in the order they ran, ``hold`` ones included, each with the hand's state after it.
        grasped: the hand's state right after closing; None if it never closed.
        stopped_in: the segment (or hand action) a stop interrupted or kept from beginning, or None.
        after: the second capture, taken while holding; None if not reached.
    """

    runs: tuple[SegmentRun, ...]
    grasped: HandState | None
    stopped_in: str | None
    after: View | None


class Delivery(Message):
    """What became of the held object after the verdict: laid into the tray, and the arm back home."""

    runs: tuple[SegmentRun, ...]
    released: HandState | None


class Verdict(Message):
    """verify: was the object really picked, and how do we know.

    Attributes:
        held: the answer. ``code``: None when held.
        hold_s: how long it was watched; ``width_min_m``: smallest hand width meanwhile.
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
    """A cycle as it begins: the first try of a pick, or another one after it failed (`cell.daemon.retry`).

    Attributes:
        number: 0 = the first. ``retry_of``: id of the cycle before, "" for the first.
        missed: base_from_tcp of grasps that closed on nothing in the cycles before; planning leaves them out.
    """

    cycle_id: str
    number: int = 0
    retry_of: str = ""
    missed: tuple[Transform, ...] = ()


class Failure(Message):
    """Why a stage ended the cycle. ``rejected``: by plan, every way to grasp that is not feasible."""

    code: Code
    text: str
    rejected: tuple[Rejection, ...] = ()

    @classmethod
    def of(cls, error: CycleFailure) -> Failure:
        return cls(code=error.failure, text=error.text, rejected=tuple(error.rejected))


class StageRecord(Message, Generic[ResultT]):
    """What one stage of one cycle did: published and recorded under ``cycle/{stage}``.

    Exactly one of ``result`` and ``failure`` is set.
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
