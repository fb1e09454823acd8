"""The reasons a cycle can end without success: a closed list, each code with advice for the operator."""

import re
from enum import StrEnum

_QUOTED = re.compile(r"'[^']+'|\"[^\"]+\"")


class Code(StrEnum):
    """Reasons a cycle did not end in SUCCESS."""

    NO_OBJECT = "NO_OBJECT"
    TARGET_NOT_FOUND = "TARGET_NOT_FOUND"
    OBSTRUCTED = "OBSTRUCTED"
    NOT_SEEN = "NOT_SEEN"
    NO_DEPTH = "NO_DEPTH"
    NO_TABLE = "NO_TABLE"
    TABLE_MOVED = "TABLE_MOVED"
    TOO_NEAR = "TOO_NEAR"
    NO_GRASP = "NO_GRASP"
    LEFT_OVER = "LEFT_OVER"
    UNREACHABLE = "UNREACHABLE"
    COLLISION = "COLLISION"
    MODEL_REFUSED = "MODEL_REFUSED"
    MODEL_ACCESS = "MODEL_ACCESS"
    MODEL_QUOTA = "MODEL_QUOTA"
    MODEL_TIMEOUT = "MODEL_TIMEOUT"
    MODEL_UNAVAILABLE = "MODEL_UNAVAILABLE"
    MODEL_NO_IMAGE = "MODEL_NO_IMAGE"
    MODEL_BAD_IMAGE = "MODEL_BAD_IMAGE"
    MODEL_NO_ROD = "MODEL_NO_ROD"
    MODEL_DRIFT = "MODEL_DRIFT"
    MODEL_FAILED = "MODEL_FAILED"
    SPEND_LIMIT = "SPEND_LIMIT"
    DETECTOR_FAILED = "DETECTOR_FAILED"
    DETECTOR_TIMEOUT = "DETECTOR_TIMEOUT"
    STALE_FRAME = "STALE_FRAME"
    BAD_FRAME = "BAD_FRAME"
    ARM_REFLEX = "ARM_REFLEX"
    MOTION_REFUSED = "MOTION_REFUSED"
    HAND_FAULT = "HAND_FAULT"
    CONTACT = "CONTACT"
    GRASP_MISSED = "GRASP_MISSED"
    DROPPED = "DROPPED"
    NOT_CLEARED = "NOT_CLEARED"
    REJECTED = "REJECTED"
    APPROVAL_TIMEOUT = "APPROVAL_TIMEOUT"
    MULTI_PICK = "MULTI_PICK"
    CANCELLED = "CANCELLED"
    DEADLINE = "DEADLINE"
    STOPPED = "STOPPED"
    DEVICE_LOST = "DEVICE_LOST"
    NODE_LOST = "NODE_LOST"
    RECORDING = "RECORDING"
    INTERNAL = "INTERNAL"


FROM_OUTSIDE = frozenset(
    {
        Code.STOPPED,
        Code.CANCELLED,
        Code.DEADLINE,
        Code.APPROVAL_TIMEOUT,
        Code.DEVICE_LOST,
        Code.NODE_LOST,
        Code.RECORDING,
    }
)
"""Ends of a computation from outside: by a command, a clock, a device, a disk. Its inputs do not lead to them, so that
the same inputs need not end so again."""

PLACE_OUT_OF_REACH = (
    "Name a place nearer to the arm, or lower: the thing itself can be grasped. The place is that of the job, or"
    " scene.place_m of the station."
)
"""The advice of UNREACHABLE where it is the place that the arm does not reach."""

PLACE_TAKEN = (
    "Empty the tray, or name another place: the thing itself can be grasped, and has no room there."
    " scene.place_pattern_m may give more places, scene.place_higher_m lets things go on top of others."
)
"""The advice of COLLISION where most ways to grasp end at the place."""

DETECTOR_FOUND_NONE = (
    "The detector of another package found nothing: its documentation says what it needs. Or set perception.detector to"
    " 'vlad'."
)
"""The advice of NO_GRASP where another package's detector gave it."""

DROPPED_BY_JOB = (
    "The object slipped, and the job limits the force (grasp.max_force_n): raise that, or choose a rougher finger pad."
)
"""The advice of DROPPED where the job gave the force."""

ADVICE: dict[Code, str] = {
    Code.NO_OBJECT: "Put an object into the pick region, inside the camera's view.",
    Code.TARGET_NOT_FOUND: "Name it differently, or point at it by its pixel: the picture is in the report.",
    Code.OBSTRUCTED: "Ask for what lies on it first, send the job with clear_way, or take it away by hand.",
    Code.NOT_SEEN: "Look at the report's picture: is the lens covered, the pick region in view, and nothing in front of"
    " it? Look from above, or from another side (arm.capture_q_rad).",
    Code.NO_DEPTH: "The camera cannot measure glass, black and shiny things, nor what is too near: take it out by hand,"
    " dull it, or look from farther away.",
    Code.NO_TABLE: "Is the table in view, and scene.table at its height? If it did not move, calibrate the camera.",
    Code.TABLE_MOVED: "Calibrate the camera with `cell calibrate`, or correct scene.table in the station file.",
    Code.TOO_NEAR: "Look from farther away (arm.capture_q_rad), or take the object out by hand.",
    Code.NO_GRASP: "Lay it so that two opposite faces stand upright, a narrow part between them, with room for a finger"
    " on either side; or take it out by hand.",
    Code.LEFT_OVER: "The reports of the cycles before say why each failed. Turn them or take them out by hand, and"
    " start again: then all are tried anew.",
    Code.UNREACHABLE: "Move the object nearer to the middle of the pick region.",
    Code.COLLISION: "The reason says what was in the way of each grasp: make room there, or turn the object.",
    Code.MODEL_REFUSED: "Read the model's reply in the report; rephrase the target or use another model.",
    Code.MODEL_ACCESS: "Check the key in the environment, and that its account may use the configured model.",
    Code.MODEL_QUOTA: "The provider limits this account's rate or credit; wait, raise the quota or use another model.",
    Code.MODEL_TIMEOUT: "Raise perception.hosted.deadline_s, or use a faster model or the embedded one.",
    Code.MODEL_UNAVAILABLE: "Check the network and the provider's status page; the embedded model needs neither.",
    Code.MODEL_NO_IMAGE: "The model answered in words where a picture was due: read them in the report.",
    Code.MODEL_BAD_IMAGE: "What came back is no usable picture; try again or use another model.",
    Code.MODEL_NO_ROD: "Look at the goal image in the report; try again, or raise perception.imagine.samples.",
    Code.SPEND_LIMIT: "Raise perception.hosted.max_cycle_usd or max_day_usd, or use the embedded model.",
    Code.MODEL_DRIFT: "The goal image no longer shows the observed object; try again or use another model.",
    Code.MODEL_FAILED: "The reason names the goal-image model, its package and what it did: correct it, or set"
    " perception.model to 'geometric'.",
    Code.DETECTOR_FAILED: "The reason names the detector and what it did: correct it, or set perception.detector to"
    " 'vlad'.",
    Code.DETECTOR_TIMEOUT: "Raise perception.detector_deadline_s, use a faster machine, or set perception.detector to"
    " 'vlad'.",
    Code.STALE_FRAME: "Check the camera's cable, power and node.",
    Code.BAD_FRAME: "Correct that field where the frame is made, in the camera's driver or your program: docs/frames.md"
    " says what it has to be. Then `cell clear` and `cell reset`.",
    Code.ARM_REFLEX: "Clear what the arm touched, then `cell clear` and `cell reset`.",
    Code.MOTION_REFUSED: "The guard refused the motion; the report names the limit. Nothing moved.",
    Code.HAND_FAULT: "Check the hand's power and home it again with `cell reset`.",
    Code.CONTACT: "Look what stands beside the object or over it, and whether table and object are where the report"
    " shows them. If there was nothing, raise execute.contact_n, or correct fr3.load.",
    Code.GRASP_MISSED: "The fingers closed on nothing. Look at the report's rectangle and aligned clouds.",
    Code.DROPPED: "The object slipped. Raise the grasp force or choose a rougher finger pad.",
    Code.NOT_CLEARED: "Something still lies where the object was; check for a second object.",
    Code.REJECTED: "A person did not approve the planned motion; the reason says why, if they wrote it. Change what was"
    " wrong, or name another target, and pick again.",
    Code.APPROVAL_TIMEOUT: "Nobody answered in time whether the arm may move, so it did not: pick again, or raise"
    " execute.approve_s.",
    Code.MULTI_PICK: "More than one object was laid into the tray: take out what is too many, or count them. The reason"
    " says what told so; if it was one, raise verify.max_load_n or verify.max_density_kg_m3.",
    Code.CANCELLED: "Somebody cancelled the job before the arm moved for it: send another.",
    Code.DEADLINE: "The job's time was over before the arm could begin its grasp: give it more (deadline_s), or look in"
    " the stages' times what took long.",
    Code.STOPPED: "The cycle was stopped by command. `cell reset` makes the cell ready again; after an abort,"
    " `cell clear` comes first.",
    Code.DEVICE_LOST: "Check the device's power and network, or the driver that the reason names; when it is back,"
    " `cell clear` and `cell reset`.",
    Code.NODE_LOST: (
        "A driver node is gone, hangs or talks nonsense; on a busy machine it was only kept waiting. Read what it said"
        " last, where `cell start` runs (of a service: `journalctl`), then `cell clear` and `cell reset`."
    ),
    Code.RECORDING: (
        "The recording could not be written. Check the recordings folder: its free space, and the right to write."
    ),
    Code.INTERNAL: "This is a defect. Please report it with the cycle's recording.",
}


def went_for(code: str, object_name: str, reason: str) -> str:
    """Return what a cycle went for: the object, or in quotes the words for which nothing was found.

    TARGET_NOT_FOUND is not about the object, which in simulation is what was put there.
    """
    if code != Code.TARGET_NOT_FOUND:
        return object_name
    words = _QUOTED.search(reason)
    return words[0] if words is not None else ""


def title_of(result: str, code: str, object_name: str) -> str:
    """Return result, code and object: ``FAILED DROPPED spatula``; the reason, which follows, has words not found."""
    return " ".join(part for part in (result, code, went_for(code, object_name, "")) if part)
