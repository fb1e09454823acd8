"""Every error this project raises, grouped by how the caller can react to it.

::

    CellError                 .exit_code  .code  .advice
    ├── ConfigError           2  the station file, an option or an argument is wrong: correct it
    │   └── PlugInMissing        no installed package brings the plug-in that is named
    ├── RecordingError        2  a recording cannot be read or replayed
    │   ├── CatalogueError       the catalogue of recordings cannot be read, written or asked
    │   ├── PicturesTrimmed      a recording without its pictures cannot be replayed
    │   ├── NotHere              what a recording was made with is not on this machine: it can be read, not replayed
    │   └── ArchiveError         a recording cannot be copied into the archive, or its copy differs
    ├── BusError              4  the other process cannot be reached
    │   ├── PortOccupied         another program listens on our endpoint
    │   ├── CellUnreachable      no cell at this endpoint
    │   ├── NoReply              no process serves this key (node down, or refused silently)
    │   ├── ReplyTimeout         a process serves the key, but did not answer in time
    │   ├── TwoAnswers           two sessions serve the same key: neither answer is used
    │   └── BadPayload           a payload does not fit its schema
    ├── Refused               3  the cell refused a command: see .code, .available
    ├── NotReached            1  the cell accepted a command, and came to rest in another state
    ├── DriverError           1  a device failed
    │   ├── DriverUnavailable 2  cannot be started here (package, display, rights)
    │   │   └── DeviceAbsent  1  its device does not answer; it may be switched on later
    │   ├── NotConnected         used before connect() or after close()
    │   ├── DeviceLost           the device no longer answers; recover() or the next use connects anew
    │   ├── MotionRefused        the guard's check failed; nothing moved
    │   ├── ArmReflex            the arm stopped itself; needs recover()
    │   ├── HandFault            the hand did not do what was asked
    │   ├── StaleFrame           the camera gave no fresh frame
    │   └── BadFrame             a frame or camera pose that cannot be one; the text names the field
    ├── CalibrationError      1  a calibration has no good result
    └── CycleFailure          1  a stage of the cycle ended it: .code from bus.codes
"""

from __future__ import annotations

from collections.abc import Sequence

from bus.arrays import Vector3
from bus.codes import ADVICE, Code
from bus.rejection import Rejection


class CellError(Exception):
    """Root of the tree. ``str(error)`` is one clear sentence for a person.

    Args:
        text: what happened.
        advice: what to do about it, one sentence.
    """

    exit_code = 1
    code = "ERROR"

    def __init__(self, text: str, advice: str = "") -> None:
        super().__init__(text)
        self.text = text
        self.advice = advice

    def __str__(self) -> str:
        return f"{self.text} {self.advice}".strip()


class ConfigError(CellError):
    """The station file, an option or an argument is wrong."""

    exit_code = 2
    code = "CONFIG"


class PlugInMissing(ConfigError):
    """No installed package brings the plug-in that is named.

    Args:
        kind: of plug-in, in words. ``name``: of it. ``key``: the setting that names it. ``group``: of its entry point.
    """

    def __init__(
        self, text: str, advice: str = "", *, kind: str = "", name: str = "", key: str = "", group: str = ""
    ) -> None:
        super().__init__(text, advice)
        self.kind, self.name, self.key, self.group = kind, name, key, group


class RecordingError(CellError):
    """A recording cannot be read or replayed."""

    exit_code = 2
    code = "RECORDING"


class CatalogueError(RecordingError):
    """The catalogue of recordings cannot be read or written, or a question to it is refused."""

    code = "CATALOGUE"


class PicturesTrimmed(RecordingError):
    """The pictures of a recording were trimmed, so its stages cannot run again."""

    code = "TRIMMED"


class NotHere(RecordingError):
    """A package, weights or an arm's description that a recording was made with is not on this machine.

    The recording is whole, and can be read; only its stages cannot run again.
    """

    code = "NOT_HERE"


class StageNotReached(RecordingError):
    """The recorded cycle ended before the stages that are asked for."""


class ArchiveError(RecordingError):
    """A recording cannot be copied into the archive, or what is read back differs; the recording stays."""

    code = "ARCHIVE"


class BusError(CellError):
    """The other process cannot be reached, or this session is closed."""

    exit_code = 4
    code = "BUS"


class PortOccupied(BusError):
    """Another program listens on the cell's endpoint."""

    code = "PORT_OCCUPIED"


class CellUnreachable(BusError):
    """No cell answers at the endpoint."""

    code = "UNREACHABLE_CELL"


class NoReply(BusError):
    """No process serves the key: its node is down, or access control refused silently."""

    code = "NO_REPLY"


class ReplyTimeout(BusError):
    """A process serves the key, but did not answer in time."""

    code = "REPLY_TIMEOUT"


class TwoAnswers(BusError):
    """Two sessions serve the same key; neither answer is used."""

    code = "TWO_ANSWERS"


class BadPayload(BusError):
    """A payload does not fit its schema."""

    code = "BAD_PAYLOAD"


class Refused(CellError):
    """The cell, or a node, refused a command or query.

    Args:
        code: short reason, e.g. ``WRONG_STATE``.
        available: commands that would be accepted now. ``state``: of the cell, where it refused a command.
    """

    exit_code = 3

    def __init__(
        self, text: str, advice: str = "", *, code: str = "REFUSED", available: tuple[str, ...] = (), state: str = ""
    ) -> None:
        super().__init__(text, advice)
        self.code = code
        self.available = available
        self.state = state


class NotReached(CellError):
    """The cell accepted a command, and came to rest in another state than the one that it leads to."""

    code = "NOT_REACHED"


class DriverError(CellError):
    """A device failed."""

    code = "DRIVER"


class DriverUnavailable(DriverError):
    """The driver cannot be started here: a package, display, right or address is missing."""

    exit_code = 2
    code = "DRIVER_UNAVAILABLE"


class DeviceAbsent(DriverUnavailable):
    """The device does not answer. Unlike other reasons it may pass by itself: a service tries again."""

    exit_code = 1


class NotConnected(DriverError):
    """The driver was used before ``connect()`` or after ``close()``."""

    code = "NOT_CONNECTED"


class DeviceLost(DriverError):
    """The device no longer answers; ``recover()`` or the next use connects anew."""

    code = "DEVICE_LOST"


class MotionRefused(DriverError):
    """The guard's check failed, or the robot refused the motion; nothing moved."""

    code = "MOTION_REFUSED"


class ArmReflex(DriverError):
    """The arm stopped itself and needs ``recover()``."""

    code = "ARM_REFLEX"


class HandFault(DriverError):
    """The hand did not do what was asked."""

    code = "HAND_FAULT"


class StaleFrame(DriverError):
    """The camera gave no fresh frame."""

    code = "STALE_FRAME"


class BadFrame(DriverError):
    """A frame or a camera pose cannot be one: sizes, channels, units, intrinsics, or a pose that is not rigid."""

    code = "BAD_FRAME"


class CalibrationError(CellError):
    """A calibration has no good result."""

    code = "CALIBRATION"


class CycleFailure(CellError):
    """A stage ended the cycle, with one of the closed list of codes.

    Args:
        rejected: from the plan stage, every way to grasp that is not feasible.
        obstacle_m: (3,) of OBSTRUCTED, the top of what lies on the target, in ``base``.
        advice: what to do, where the reason says more than the code; "" = the advice of the code.
    """

    def __init__(
        self,
        code: Code,
        text: str,
        rejected: Sequence[Rejection] = (),
        *,
        obstacle_m: Vector3 | None = None,
        advice: str = "",
    ) -> None:
        super().__init__(text, advice or ADVICE[code])
        self.code = code.value
        self.failure = code
        self.rejected = rejected
        self.obstacle_m = obstacle_m
