"""Frozen types of every message in the cell.

SI units and radians; frames are named in the fields (``a_from_b`` maps b-coordinates to a); times are integer
nanoseconds UTC. Frames: ``base``, ``flange``, ``hand``, ``tcp`` (z = approach, y = closing axis), ``color`` (the colour
camera, optical: x right, y down, z forward), ``depth``. Definitions: docs/frames.md.
"""

from bus.messages.approval import Approval, Decision, Proposal
from bus.messages.camera_model import CameraModel
from bus.messages.cycle import (
    Attempt,
    CycleResult,
    EarlierAttempt,
    Failure,
    FoundThing,
    GraspOutcome,
    Laid,
    ResultT,
    StageName,
    StageRecord,
)
from bus.messages.detections import Alignment, Detections, Drift, Evidence, ModelReply, Usage
from bus.messages.devices import ArmMode, ArmState, Frame, HandState, Motion
from bus.messages.execution import Contact, Delivery, Execution, SegmentRun, Verdict
from bus.messages.grasps import Grasp, Rectangle
from bus.messages.job import GraspHints, Job, Place, Target
from bus.messages.live_picture import LivePicture, PictureRequest
from bus.messages.observation import Observation, View
from bus.messages.plan import ONLY_TO_LOOK, PickPlan, Segment, SegmentName
from bus.messages.plan_view import NamedBox, Outline, PlannedPath, PlanView
from bus.messages.scene import Instance, ObservedScene, SeenMount, SeenTable, Tried

__all__ = [
    "ONLY_TO_LOOK",
    "Alignment",
    "Approval",
    "ArmMode",
    "ArmState",
    "Attempt",
    "CameraModel",
    "Contact",
    "CycleResult",
    "Decision",
    "Delivery",
    "Detections",
    "Drift",
    "EarlierAttempt",
    "Evidence",
    "Execution",
    "Failure",
    "FoundThing",
    "Frame",
    "Grasp",
    "GraspHints",
    "GraspOutcome",
    "HandState",
    "Instance",
    "Job",
    "Laid",
    "LivePicture",
    "ModelReply",
    "Motion",
    "NamedBox",
    "Observation",
    "ObservedScene",
    "Outline",
    "PickPlan",
    "PictureRequest",
    "Place",
    "PlanView",
    "PlannedPath",
    "Proposal",
    "Rectangle",
    "ResultT",
    "SeenMount",
    "SeenTable",
    "Segment",
    "SegmentName",
    "SegmentRun",
    "StageName",
    "StageRecord",
    "Target",
    "Tried",
    "Usage",
    "Verdict",
    "View",
]
