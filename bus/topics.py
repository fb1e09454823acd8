"""THE table: every key of the cell, its payload types, who may ask or publish it, and whether it is recorded.

Keys are below ``cell/{cell_id}/``. A *publish* topic carries ``says``; a *query* topic is asked with ``asks`` and
answered with ``says``; *alive* topics are liveliness tokens without payload. A query that *acts* answers only its exact
key, its own payload and the clients named in its row (`bus.access`); one that reads answers every client.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from bus.commands import (
    BusSchema,
    CellHealth,
    CellState,
    CommandReply,
    CommandRequest,
    ErrorReply,
    Event,
    HandGrasp,
    HandMove,
    Health,
    Heartbeat,
    Nothing,
    Presented,
    PresentRequest,
    ResultRequest,
    Stranger,
)
from bus.fault_injection import FaultRequest
from bus.foxglove import FoxgloveType
from bus.frozen import Message
from bus.messages import (
    Approval,
    ArmState,
    Attempt,
    CycleResult,
    Delivery,
    Detections,
    Execution,
    HandState,
    LivePicture,
    ModelReply,
    Motion,
    ObservedScene,
    PickPlan,
    PictureRequest,
    PlanView,
    Proposal,
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
        asks: type of the query's payload.
        logged: recorded into the cycle's MCAP.
        acts: who may ask, where the answer is an act: ``client``, any program that names itself (`cell.machine.leases`
            decides which), or ``cell``, the cell's own session. Empty: the answer only reads.
        speaker: who publishes it; a payload of any other session is a stranger's.
    """

    key: str
    kind: Literal["publish", "query", "alive"]
    says: Any = None
    asks: Any = None
    logged: bool = True
    acts: Literal["", "client", "cell"] = ""
    speaker: Literal["cell", "node", "both", "client"] = "cell"


COMMAND = Topic("command/{verb}", "query", CommandReply, CommandRequest, acts="client")
STATE = Topic("state", "publish", CellState)
STATE_NOW = Topic("state", "query", CellState, Nothing, logged=False)
HEARTBEAT = Topic("heartbeat", "publish", Heartbeat, logged=False)
HEALTH = Topic("health", "publish", CellHealth)
HEALTH_NOW = Topic("health", "query", CellHealth, Nothing, logged=False)
SCHEMA_NOW = Topic("schema", "query", BusSchema, Nothing, logged=False)
EVENT = Topic("event", "publish", Event, speaker="both")

ATTEMPT = Topic("cycle/attempt", "publish", Attempt)
CAPTURE = Topic("cycle/capture", "publish", StageRecord[View])
SCENE = Topic("cycle/scene", "publish", ObservedScene)
"""Of a cycle whose detection failed: a successful one holds it in its result."""
DETECT = Topic("cycle/detect", "publish", StageRecord[Detections])
PLAN = Topic("cycle/plan", "publish", StageRecord[PickPlan])
PROPOSAL = Topic("cycle/proposal", "publish", Proposal)
PROPOSAL_NOW = Topic("cycle/proposal", "query", Proposal, Nothing, logged=False)
APPROVE = Topic("cycle/approve", "publish", StageRecord[Approval])
EXECUTE = Topic("cycle/execute", "publish", StageRecord[Execution])
VERIFY = Topic("cycle/verify", "publish", StageRecord[Verdict])
DELIVER = Topic("cycle/deliver", "publish", StageRecord[Delivery])
RESULT = Topic("cycle/result", "publish", CycleResult)
RESULT_NOW = Topic("cycle/result", "query", CycleResult, ResultRequest, logged=False)

MODEL_REPLY = Topic("model/reply", "publish", ModelReply)

# The cycle as pictures, drawn from the stages' results (`logs.live_views`), for any viewer of Foxglove's schemas.
VIEW_COLOR = Topic("view/color", "publish", CompressedImage)
VIEW_ANNOTATIONS = Topic("view/annotations", "publish", ImageAnnotations)
VIEW_GOAL = Topic("view/goal", "publish", CompressedImage)
VIEW_CLOUD = Topic("view/cloud", "publish", PointCloud)
VIEW_SCENE = Topic("view/scene", "publish", SceneUpdate)
VIEW_LOG = Topic("view/log", "publish", Log)
PLAN_NOW = Topic("view/plan", "query", PlanView, Nothing, logged=False)
PICTURE_NOW = Topic("view/picture", "query", LivePicture, PictureRequest, logged=False)

# A capture is answered by the five below, one reply each; they are recorded as those replies, not as published.
CAMERA_CAPTURE = Topic("camera/capture", "query", None, Nothing, acts="cell")
CAMERA_COLOR = Topic("camera/color", "publish", CompressedImage, logged=False, speaker="node")
CAMERA_DEPTH = Topic("camera/depth", "publish", RawImage, logged=False, speaker="node")
CAMERA_COLOR_CALIBRATION = Topic("camera/color/calibration", "publish", CameraCalibration, logged=False, speaker="node")
CAMERA_DEPTH_CALIBRATION = Topic("camera/depth/calibration", "publish", CameraCalibration, logged=False, speaker="node")
CAMERA_TF = Topic("camera/tf", "publish", FrameTransforms, logged=False, speaker="node")

ARM_STATE = Topic("arm/state", "publish", JointStates, speaker="node")
ARM_NOW = Topic("arm/now", "query", ArmState, Nothing, logged=False)
ARM_EXECUTE = Topic("arm/execute", "query", Motion, Trajectory, acts="cell")
ARM_STOP = Topic("arm/stop", "query", Nothing, Nothing, acts="cell")
ARM_HOLD = Topic("arm/hold", "query", Nothing, Nothing, acts="cell")
ARM_RESUME = Topic("arm/resume", "query", Nothing, Nothing, acts="cell")
ARM_RECOVER = Topic("arm/recover", "query", Nothing, Nothing, acts="cell")

TF = Topic("tf", "publish", FrameTransforms)

HAND_STATE = Topic("hand/state", "publish", HandState, speaker="node")
HAND_NOW = Topic("hand/now", "query", HandState, Nothing, logged=False)
HAND_MOVE = Topic("hand/move", "query", HandState, HandMove, acts="cell")
HAND_GRASP = Topic("hand/grasp", "query", HandState, HandGrasp, acts="cell")
HAND_HOME = Topic("hand/home", "query", HandState, Nothing, acts="cell")
HAND_STOP = Topic("hand/stop", "query", Nothing, Nothing, acts="cell")

SIM_PRESENT = Topic("sim/present", "query", Presented, PresentRequest, acts="cell")
SIM_TRUTH = Topic("sim/truth", "query", Presented, Nothing)

# Answered only where the station allows faults, by the process that runs the part.
FAULT = Topic("fault/{part}", "query", Nothing, FaultRequest, logged=False, acts="client")

NODE_ALIVE = Topic("node/{name}", "alive")
LEASE = Topic("lease/{name}", "alive")
LEASE_HEARTBEAT = Topic("lease/{name}", "publish", Heartbeat, logged=False, speaker="client")
NODE_HEALTH = Topic("node/{name}/health", "publish", Health, speaker="node")
NODE_NOW = Topic("node/{name}/health", "query", Health, Nothing, logged=False)

# A payload that another session put on a key of this table while a cycle ran: recorded, but never used.
STRANGER = Topic("stranger", "publish", Stranger)

TOPICS: tuple[Topic, ...] = tuple(value for value in dict(globals()).values() if isinstance(value, Topic))

FRAME_PARTS = (CAMERA_COLOR, CAMERA_DEPTH, CAMERA_COLOR_CALIBRATION, CAMERA_DEPTH_CALIBRATION, CAMERA_TF)


def encoding_of(payload_type: Any) -> str:
    """Return the Zenoh encoding of a type: ``application/json;vlad.X`` or ``application/protobuf;foxglove.X``."""
    if isinstance(payload_type, type) and issubclass(payload_type, Message):
        name = payload_type.__name__.replace("[", ".").rstrip("]")
        return f"application/json;vlad.{name}"
    return f"application/protobuf;{payload_type.full_name}"


def types_by_encoding() -> dict[str, Any]:
    """Return every payload type of the table by its encoding, `ErrorReply` included."""
    types = [payload for topic in TOPICS for payload in (topic.says, topic.asks) if payload is not None]
    return {encoding_of(payload): payload for payload in [*types, ErrorReply]}
