"""Maps libfranka's exceptions to errors of our tree, with the robot's own error names and the advice for Desk."""

from __future__ import annotations

import re
from typing import Any

from bus.errors import ArmReflex, DeviceAbsent, DeviceLost, DriverError, DriverUnavailable, MotionRefused
from bus.messages import ArmMode

_MODES = {1: ArmMode.IDLE, 2: ArmMode.MOVE, 4: ArmMode.REFLEX, 5: ArmMode.USER_STOPPED}
"""libfranka's RobotMode; the others (0 other, 3 guiding, 6 automatic error recovery) are `ArmMode.OTHER`."""

_ADVICE_OF_MODE = {
    0: "In Desk: unlock the joints, choose Execution and activate FCI; the arm's lights turn green.",
    3: "Let go of the guiding button on the arm; in Desk choose Execution.",
    4: "Clear what the arm touched, then `cell clear` and `cell reset`.",
    5: "Release the external activation device (user stop) and the emergency stop, until the lights are green.",
    6: "The arm recovers from an error; wait a moment.",
}

_ADVICE_OF_REFLEX = (
    ("communication_constraints", "Commands came too late: a PREEMPT_RT kernel, a direct cable and a CPU governor of"
     " `performance` are needed (`cell doctor`)."),
    ("discontinuity", "Commands came late, most likely (`lost_cycles` of the arm's health, `cell doctor`); if none did,"
     " keep this recording: it is a defect of planning."),
    ("limits_violation", "A joint came to its end: keep this recording, it is a defect of planning."),
    ("self_collision", "The arm nearly touched itself: keep this recording, it is a defect of planning."),
    ("reflex", "The arm touched something: clear it. If there was nothing, raise fr3.collision_torque_nm or correct"
     " fr3.load."),
    ("tau_j_range", "Too much torque: is fr3.load right, and the object not too heavy?"),
    ("power_limit", "Too fast for the load: lower arm.speed."),
)  # fmt: skip
_RECOVER = "Then `cell clear` and `cell reset`."


def arm_mode(mode: int) -> ArmMode:
    """Convert libfranka's RobotMode to ours."""
    return _MODES.get(mode, ArmMode.OTHER)


def advice_of_mode(mode: int) -> str:
    """Return what the operator has to do so that the arm may move; "" in the modes where it may."""
    return _ADVICE_OF_MODE.get(mode, "")


def raised_by(franka: Any) -> tuple[type[Exception], ...]:
    """Return every exception type of the module ``pylibfranka``; they have no common base."""
    kinds = ("Command", "Control", "Franka", "InvalidOperation", "Network", "Realtime")
    return tuple(getattr(franka, f"{kind}Exception") for kind in kinds)


def connect_error(error: Exception, address: str) -> DriverError:
    """Return the error for a failed connection to the robot at ``address``."""
    text = f"The FR3 at {address} cannot be used: {error}."
    kind = type(error).__name__
    if kind == "RealtimeException":
        return DriverUnavailable(
            text, 'Boot a PREEMPT_RT kernel (`cell doctor`). fr3.realtime = "ignore" is for simulators only.'
        )
    if "ncompatible library version" in str(error):
        return DriverUnavailable(text, "Update the robot's system image to 5.9 or newer (Desk, Settings, System).")
    if "another" in str(error) or "refused" in str(error).lower():
        return DeviceAbsent(text, "In Desk: activate FCI; no other program may hold the robot.")
    return DeviceAbsent(text, "Check power, cable and fr3.address; in Desk unlock the joints and activate FCI.")


def motion_error(error: Exception) -> DriverError:
    """Return the error for an exception that ended a motion, or prevented its start."""
    kind, said = type(error).__name__, " ".join(str(error).replace("libfranka:", "").split())
    if kind == "ControlException":
        names = re.findall(r'"([a-z_0-9]+)"', said)
        if not names:
            return ArmReflex(f"The arm stopped itself: {said}.", _RECOVER)
        hints = [advice for part, advice in _ADVICE_OF_REFLEX if part in " ".join(names)]
        return ArmReflex(f"The arm stopped itself: {', '.join(names)}.", " ".join([*hints[:1], _RECOVER]))
    if kind == "NetworkException":
        return DeviceLost(f"The connection to the arm was lost: {said}.", "Check its power and network. " + _RECOVER)
    if kind == "CommandException":
        mode = next((mode for mode, name in _NAMES.items() if f'"{name}"' in said), 0)
        return MotionRefused(f"The arm refused to move: {said}.", advice_of_mode(mode))
    return DriverError(f"libfranka: {said} ({kind}).", _RECOVER)


_NAMES = {0: "Other", 1: "Idle", 2: "Move", 3: "Guiding", 4: "Reflex", 5: "User stopped", 6: "Automatic error recovery"}
"""The modes' names in libfranka's texts."""
