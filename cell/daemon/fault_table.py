"""THE table of injected faults: the outcome for each part and each kind of fault.

`benchmarks.soak` injects all of them, and the tests compare the outcomes with this table; docs/faults.md is generated
from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from bus.codes import ADVICE, Code

Result = Literal["SUCCESS", "FAILED", "ABORTED"]

_LOST = (Code.DEVICE_LOST, Code.NODE_LOST)
PICK_CODES = (Code.NO_OBJECT, Code.TARGET_NOT_FOUND, Code.NOT_SEEN, Code.NO_DEPTH, Code.NO_TABLE,
         Code.TABLE_MOVED, Code.TOO_NEAR, Code.NO_GRASP, Code.LEFT_OVER, Code.UNREACHABLE, Code.COLLISION,
         Code.MODEL_NO_ROD, Code.MODEL_DRIFT, Code.CONTACT, Code.GRASP_MISSED, Code.DROPPED,
         Code.NOT_CLEARED, Code.MULTI_PICK)  # fmt: skip
"""Failures of a pick that was planned on wrong observations."""


@dataclass(frozen=True)
class Row:
    """One kind of fault in one part.

    Attributes:
        part: of `bus.fault_injection.PARTS`, or ``node``: a node's process; or of `DOORS`: its process, or the client
            that attends the cycle through it.
        word: of `bus.fault_injection.Fault`, or the signal's; of a door also ``client``: its client is killed, and
            ``taken``: it is killed, and another program takes its port.
        sets_in: the moment of the cycle for which ``result`` and ``code`` hold; ``begin`` is before its first stage.
        result, code: of that cycle.
        does: what the cell detects and does. ``then``: what is needed to recover besides clear and reset.
        also: codes of the cycle when the fault sets in at another moment; SUCCESS when it came too late to matter.
        holds: the cell is Held meanwhile, until a client says ``unhold``.
    """

    part: str
    word: str
    sets_in: str
    result: Result
    code: Code | None
    does: str
    then: str = ""
    also: tuple[Code, ...] = ()
    holds: bool = False

    @property
    def name(self) -> str:
        """Part and kind of fault, e.g. ``camera off``."""
        return f"{self.part} {self.word}"

    @property
    def advice(self) -> str:
        """The advice for the operator."""
        if self.holds:
            return "See that nobody is in the way, then `cell unhold`; or `cell stop`."
        return "" if self.code is None else ADVICE[self.code]

    @property
    def allowed(self) -> set[Code | None]:
        """All codes with which such a cycle may end, whenever the fault sets in."""
        return {self.code, None, *self.also}


DOORS = ("http", "opcua")


def _of_door(door: str) -> tuple[Row, ...]:
    """The rows of one door; each of a cycle that a client attends through it."""
    held = "The cell holds, as its client is gone with it; the cycle goes on when told to."
    again = "The door is started again (`DOOR_LOST`, `DOOR_OPEN`)."
    return (
        Row(door, "client", "execute", "SUCCESS", None,
            "The connection is reset: the cell holds at once; the cycle goes on when told to.", holds=True),
        Row(door, "kill", "execute", "SUCCESS", None, held, again, holds=True),
        Row(door, "freeze", "execute", "SUCCESS", None,
            "Its heartbeat is missing: the cell holds after `bus.silence_s`; the cycle goes on when told to.",
            "The door is ended after 2 s, and started again.", holds=True),
        Row(door, "taken", "execute", "SUCCESS", None, held,
            "The door is tried again (`DOOR_CLOSED`) until its port is free.", holds=True),
    )  # fmt: skip


ROWS: tuple[Row, ...] = (
    Row("camera", "off", "capture", "ABORTED", Code.DEVICE_LOST, "The capture is refused."),
    Row("camera", "stuck", "execute", "ABORTED", Code.STALE_FRAME,
        "A frame that is not newer than the last one is never used."),
    Row("camera", "garbage", "capture", "ABORTED", Code.DEVICE_LOST,
        "A frame with hardly any depth is a blind camera, not an empty table.", also=(Code.STALE_FRAME, *PICK_CODES)),
    Row("camera", "wrong", "capture", "SUCCESS", None,
        "A mirrored colour image over a true depth image cannot be noticed: the embedded model works on depth. A"
        " hosted model may draw on the wrong thing; then the pick fails as it may.", also=PICK_CODES),
    Row("camera", "slow", "capture", "SUCCESS", None,
        "Captures take longer. A frame older than `camera.max_age_s`, or a question longer than `bus.ask_timeout_s`,"
        " ends the cycle.", also=(Code.STALE_FRAME, Code.NODE_LOST)),
    Row("arm", "off", "execute", "ABORTED", Code.DEVICE_LOST, "It brakes; its motion ends with an error.", also=_LOST),
    Row("arm", "stuck", "execute", "ABORTED", Code.DEVICE_LOST,
        "Its state repeats itself for `bus.stale_s`: the motion that never ends is stopped.", also=_LOST),
    Row("arm", "garbage", "execute", "ABORTED", Code.MOTION_REFUSED,
        "The guard lets an arm that does not know where it is play nothing; no speed confirms that it rests.",
        also=_LOST),
    Row("arm", "wrong", "execute", "ABORTED", Code.MOTION_REFUSED,
        "Between two motions the guard sees that it is elsewhere. An arm that was wrong before its reset cannot be"
        " noticed: it sees and grasps beside the object.", also=(Code.ARM_REFLEX, Code.STALE_FRAME, *PICK_CODES)),
    Row("arm", "slow", "execute", "SUCCESS", None,
        "Motions begin and end late, and the node's health shows it. A state older than `bus.stale_s` is a lost node;"
        " stops come through at once.", also=_LOST),
    Row("hand", "off", "execute", "ABORTED", Code.DEVICE_LOST, "Its next command is refused.", also=_LOST),
    Row("hand", "stuck", "execute", "ABORTED", Code.HAND_FAULT,
        "Fingers that are not where they were told to be, or say the same as before they were told, end the cycle.",
        also=_LOST),
    Row("hand", "garbage", "execute", "ABORTED", Code.HAND_FAULT, "A width that no hand has ends the cycle."),
    Row("hand", "wrong", "execute", "ABORTED", Code.HAND_FAULT,
        "Free fingers that are not where they were told to be end the cycle. From the grasp on it cannot be noticed"
        " before they open again.", also=(Code.CONTACT, Code.DROPPED, Code.GRASP_MISSED)),
    Row("hand", "slow", "execute", "SUCCESS", None, "Grasps take longer, and the node's health shows it.", also=_LOST),
    Row("model", "off", "detect", "FAILED", Code.MODEL_UNAVAILABLE, "The pick fails; nothing moved."),
    Row("model", "stuck", "detect", "FAILED", Code.MODEL_TIMEOUT,
        "The pick fails at `perception.hosted.deadline_s`; a stop does not wait for it."),
    Row("model", "garbage", "detect", "FAILED", Code.MODEL_BAD_IMAGE, "What is no picture is not used."),
    Row("model", "wrong", "detect", "FAILED", Code.MODEL_DRIFT,
        "The goal image is compared with what was seen, and not used.", also=(Code.MODEL_NO_ROD, Code.NO_GRASP)),
    Row("model", "slow", "detect", "SUCCESS", None, "The pick takes longer.", also=(Code.MODEL_TIMEOUT,)),
    Row("bus", "off", "execute", "ABORTED", Code.NODE_LOST,
        "The node stops its arm when its link is cut; the cell notices that the node is gone.",
        "The node is ended after `bus.frozen_s`, and started again.", _LOST),
    Row("bus", "stuck", "execute", "ABORTED", Code.NODE_LOST,
        "The node's streams are silent for `bus.stale_s`. Stops still come through.",
        "The node is ended after `bus.frozen_s`, and started again.", _LOST),
    Row("bus", "garbage", "execute", "ABORTED", Code.NODE_LOST,
        "What cannot be read counts as silence, or as no answer. Stops still come through.",
        "The node is ended after `bus.frozen_s`, and started again.", _LOST),
    Row("bus", "wrong", "execute", "ABORTED", Code.NODE_LOST,
        "What does not fit its schema counts as silence, or as no answer. Stops still come through.",
        "The node is ended after `bus.frozen_s`, and started again.", _LOST),
    Row("bus", "slow", "execute", "SUCCESS", None,
        "Everything takes longer, and the node's health shows it; later than `bus.stale_s` it is lost.", also=_LOST),
    Row("disk", "off", "execute", "ABORTED", Code.RECORDING,
        "The arm rests; what was written before stays readable in the `.part`."),
    Row("disk", "stuck", "begin", "ABORTED", Code.RECORDING,
        "Nothing else waits for the disk for longer than `recording.patience_s`."),
    Row("disk", "garbage", "begin", "ABORTED", Code.RECORDING,
        "Noticed when the closed file is read back: the pick was done, but has no record."),
    Row("disk", "wrong", "execute", "ABORTED", Code.RECORDING,
        "A full disk: as off. `recording.min_free_mb` is looked at in every reset."),
    Row("disk", "slow", "execute", "SUCCESS", None,
        "What waits to be written is bounded; the end of a cycle waits for it, one step at most"
        " `recording.patience_s`.", also=(Code.RECORDING,)),
    Row("node", "kill", "execute", "ABORTED", Code.NODE_LOST, "Noticed at once.", "The node is started again.", _LOST),
    Row("node", "freeze", "execute", "ABORTED", Code.NODE_LOST, "Noticed after a second at most, or `bus.stale_s`.",
        "The node is ended after `bus.frozen_s`, and started again.", _LOST),
    *(row for door in DOORS for row in _of_door(door)),
)  # fmt: skip
