"""Every error this project raises, split by what the caller can do about it.

::

    CellError                 .exit_code  .code  .advice
    ├── ConfigError           2  the station file, an option or an argument is wrong: correct it
    ├── RecordingError        2  a recording cannot be read, or not replayed
    ├── BusError              4  the other side cannot be reached
    │   ├── PortOccupied         another program listens on our endpoint
    │   ├── CellUnreachable      no cell at this endpoint
    │   ├── NoReply              nobody answers this key (node down, or it refused silently)
    │   ├── ReplyTimeout         somebody listens, but did not answer in time
    │   ├── TwoAnswers           two sessions answer for the same thing: neither is believed
    │   └── BadPayload           an answer or message that does not fit its schema
    ├── Refused               3  the cell understood, and said no: see .code, .available
    ├── DriverError           1  a device failed
    │   ├── DriverUnavailable    cannot be started here (package, display, address)
    │   ├── NotConnected         used before connect() or after close()
    │   ├── DeviceLost           it answered, and does no longer; recover() or the next use connects anew
    │   ├── MotionRefused        the guard's check failed; nothing moved
    │   ├── ArmReflex            the arm stopped itself; needs recover()
    │   ├── HandFault            the hand did not do what was asked
    │   └── StaleFrame           the camera gave no fresh frame
    ├── CalibrationError      1  a calibration has no good result
    └── CycleFailure          1  a stage of the cycle ended it: .code from bus.codes
"""

from __future__ import annotations

from collections.abc import Sequence

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
    exit_code = 2
    code = "CONFIG"


class RecordingError(CellError):
    exit_code = 2
    code = "RECORDING"


class BusError(CellError):
    exit_code = 4
    code = "BUS"


class PortOccupied(BusError):
    code = "PORT_OCCUPIED"


class CellUnreachable(BusError):
    code = "UNREACHABLE_CELL"


class NoReply(BusError):
    code = "NO_REPLY"


class ReplyTimeout(BusError):
    code = "REPLY_TIMEOUT"


class TwoAnswers(BusError):
    code = "TWO_ANSWERS"


class BadPayload(BusError):
    code = "BAD_PAYLOAD"


class Refused(CellError):
    """The cell answered a command with no.

    Args:
        code: short reason, e.g. ``WRONG_STATE``.
        available: commands that would be accepted now. ``state``: of the cell, where it is a command's refusal.
    """

    exit_code = 3

    def __init__(
        self, text: str, advice: str = "", *, code: str = "REFUSED", available: tuple[str, ...] = (), state: str = ""
    ) -> None:
        super().__init__(text, advice)
        self.code = code
        self.available = available
        self.state = state


class DriverError(CellError):
    code = "DRIVER"


class DriverUnavailable(DriverError):
    exit_code = 2
    code = "DRIVER_UNAVAILABLE"


class NotConnected(DriverError):
    code = "NOT_CONNECTED"


class DeviceLost(DriverError):
    code = "DEVICE_LOST"


class MotionRefused(DriverError):
    code = "MOTION_REFUSED"


class ArmReflex(DriverError):
    code = "ARM_REFLEX"


class HandFault(DriverError):
    code = "HAND_FAULT"


class StaleFrame(DriverError):
    code = "STALE_FRAME"


class CalibrationError(CellError):
    code = "CALIBRATION"


class CycleFailure(CellError):
    """A stage found that the pick cannot go on, and says which of the closed list of codes it is.

    Args:
        rejected: by plan, every way to grasp that is not feasible.
    """

    def __init__(self, code: Code, text: str, rejected: Sequence[Rejection] = ()) -> None:
        super().__init__(text, ADVICE[code])
        self.code = code.value
        self.failure = code
        self.rejected = rejected
