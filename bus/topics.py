"""THE table: every key of the cell, what travels on it, and whether it is recorded.

Keys are below ``cell/{cell_id}/``. A *publish* topic carries ``says``; a *query* topic is asked with ``asks`` and
answered with ``says``; *alive* topics are liveliness tokens without payload.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from bus.commands import (
    CellHealth,
    CellState,
    CommandReply,
    CommandRequest,
    ErrorReply,
    Event,
    HandGrasp,
    HandMove,
    Health,
    Nothing,
    Presented,
    PresentRequest,
)
from bus.faults import FaultRequest
from bus.foxglove import FoxgloveType
from bus.frozen import Message
from bus.messages import (
    ArmState,
    Attempt,
    CycleResult,
    Delivery,
    Detections,
    Execution,
    HandState,
    ModelReply,
    Motion,
    PickPlan,
    StageRecord,
    Verdict,
    View,
)
from bus.trajectory import Trajectory

ROOT = "cell"

CameraCalibration = FoxgloveType("CameraCalibration")
CompressedImage = FoxgloveType("CompressedImage")
FrameTransforms = FoxgloveType("FrameTransforms")
ImageAnnotations = FoxgloveType("ImageAnnotations")
JointStates = FoxgloveType("JointStates")
Log = FoxgloveType("Log")
PointCloud = FoxgloveType("PointCloud")
RawImage = FoxgloveType("RawImage")
SceneUpdate = FoxgloveType("SceneUpdate")


@dataclass(frozen=True)
class Topic:
    """One row of the table.

    Attributes:
        key: below ``cell/{cell_id}/``; may hold a ``{field}``.
        kind: how it travels.
        says: type of the published payload or of the answer.
        asks: type of the question.
        logged: recorded into the cycle's MCAP.
    """

    key: str
    kind: Literal["publish", "query", "alive"]
    says: Any = None
    asks: Any = None
    logged: bool = True


COMMAND = Topic("command/{verb}", "query", CommandReply, CommandRequest)
STATE = Topic("state", "publish", CellState)
STATE_NOW = Topic("state", "query", CellState, Nothing, logged=False)
HEALTH = Topic("health", "publish", CellHealth)
HEALTH_NOW = Topic("health", "query", CellHealth, Nothing, logged=False)
EVENT = Topic("event", "publish", Event)

ATTEMPT = Topic("cycle/attempt", "publish", Attempt)
CAPTURE = Topic("cycle/capture", "publish", StageRecord[View])
DETECT = Topic("cycle/detect", "publish", StageRecord[Detections])
PLAN = Topic("cycle/plan", "publish", StageRecord[PickPlan])
EXECUTE = Topic("cycle/execute", "publish", StageRecord[Execution])
VERIFY = Topic("cycle/verify", "publish", StageRecord[Verdict])
DELIVER = Topic("cycle/deliver", "publish", StageRecord[Delivery])
RESULT = Topic("cycle/result", "publish", CycleResult)

MODEL_REPLY = Topic("model/reply", "publish", ModelReply)

# The cycle as pictures, drawn from the stages' results (`logs.views`): any viewer of Foxglove's schemas shows them.
VIEW_COLOR = Topic("view/color", "publish", CompressedImage)
VIEW_ANNOTATIONS = Topic("view/annotations", "publish", ImageAnnotations)
VIEW_GOAL = Topic("view/goal", "publish", CompressedImage)
VIEW_CLOUD = Topic("view/cloud", "publish", PointCloud)
VIEW_SCENE = Topic("view/scene", "publish", SceneUpdate)
VIEW_LOG = Topic("view/log", "publish", Log)

# A capture is answered by the five below, one reply each; they are recorded as those replies, not as published.
CAMERA_CAPTURE = Topic("camera/capture", "query", None, Nothing)
CAMERA_COLOR = Topic("camera/color", "publish", CompressedImage, logged=False)
CAMERA_DEPTH = Topic("camera/depth", "publish", RawImage, logged=False)
CAMERA_COLOR_CALIBRATION = Topic("camera/color/calibration", "publish", CameraCalibration, logged=False)
CAMERA_DEPTH_CALIBRATION = Topic("camera/depth/calibration", "publish", CameraCalibration, logged=False)
CAMERA_TF = Topic("camera/tf", "publish", FrameTransforms, logged=False)

ARM_STATE = Topic("arm/state", "publish", JointStates)
ARM_NOW = Topic("arm/now", "query", ArmState, Nothing, logged=False)
ARM_EXECUTE = Topic("arm/execute", "query", Motion, Trajectory)
ARM_STOP = Topic("arm/stop", "query", Nothing, Nothing)
ARM_HOLD = Topic("arm/hold", "query", Nothing, Nothing)
ARM_RESUME = Topic("arm/resume", "query", Nothing, Nothing)
ARM_RECOVER = Topic("arm/recover", "query", Nothing, Nothing)

TF = Topic("tf", "publish", FrameTransforms)

HAND_STATE = Topic("hand/state", "publish", HandState)
HAND_NOW = Topic("hand/now", "query", HandState, Nothing, logged=False)
HAND_MOVE = Topic("hand/move", "query", HandState, HandMove)
HAND_GRASP = Topic("hand/grasp", "query", HandState, HandGrasp)
HAND_HOME = Topic("hand/home", "query", HandState, Nothing)
HAND_STOP = Topic("hand/stop", "query", Nothing, Nothing)

SIM_PRESENT = Topic("sim/present", "query", Presented, PresentRequest)
SIM_TRUTH = Topic("sim/truth", "query", Presented, Nothing)

# Answered only where the station allows faults, by whoever runs that part.
FAULT = Topic("fault/{part}", "query", Nothing, FaultRequest, logged=False)

NODE_ALIVE = Topic("node/{name}", "alive")
LEASE = Topic("lease/{name}", "alive")
NODE_HEALTH = Topic("node/{name}/health", "publish", Health)

TOPICS: tuple[Topic, ...] = tuple(value for value in dict(globals()).values() if isinstance(value, Topic))

FRAME_PARTS = (CAMERA_COLOR, CAMERA_DEPTH, CAMERA_COLOR_CALIBRATION, CAMERA_DEPTH_CALIBRATION, CAMERA_TF)


def encoding_of(payload_type: Any) -> str:
    """The Zenoh encoding of a payload type: ``application/json;vlad.X`` or ``application/protobuf;foxglove.X``."""
    if isinstance(payload_type, type) and issubclass(payload_type, Message):
        name = payload_type.__name__.replace("[", ".").rstrip("]")
        return f"application/json;vlad.{name}"
    return f"application/protobuf;{payload_type.full_name}"


def types_by_encoding() -> dict[str, Any]:
    """Every payload type of the table by its encoding, and what any question may be answered with."""
    types = [payload for topic in TOPICS for payload in (topic.says, topic.asks) if payload is not None]
    return {encoding_of(payload): payload for payload in [*types, ErrorReply]}
