"""The retry policy of a failed pick: the next ranked grasp, then a new capture, and after too many failures a hold.

Each attempt is a cycle of its own, with its own recording: it captures and detects anew, because the failure may have
moved the object, and leaves out the grasps that missed before. A fault of a device is never retried.
"""

from __future__ import annotations

from bus.arrays import Transform
from bus.codes import Code
from bus.messages import Attempt
from config.schema import RetrySettings

WITH_ANOTHER_GRASP = frozenset({Code.GRASP_MISSED, Code.CONTACT})
WITH_A_NEW_LOOK = frozenset(
    {
        Code.NOT_SEEN,
        Code.NO_DEPTH,
        Code.NO_TABLE,
        Code.TOO_NEAR,
        Code.NO_GRASP,
        Code.UNREACHABLE,
        Code.COLLISION,
        Code.DROPPED,
        Code.NOT_CLEARED,
        Code.MODEL_REFUSED,
        Code.MODEL_TIMEOUT,
        Code.MODEL_UNAVAILABLE,
        Code.MODEL_NO_IMAGE,
        Code.MODEL_BAD_IMAGE,
        Code.MODEL_NO_ROD,
        Code.MODEL_DRIFT,
    }
)
"""Codes for which a new capture may help. Causes that only a person can remove (key, quota, spend limit) are left out.
"""


class Retries:
    """The attempts left for the current object, and the number of objects that failed in a row."""

    def __init__(self, settings: RetrySettings) -> None:
        self._settings = settings
        self._grasps, self._looks = settings.grasps, settings.looks
        self._failed_in_a_row = 0

    def after(self, attempt: Attempt, code: Code | None, grasp: Transform | None, next_id: str) -> Attempt | None:
        """The attempt ``next_id`` that follows ``attempt``; None for no further one.

        Args:
            code: of the end of ``attempt``; None = success.
            grasp: base_from_tcp (4, 4) of the executed grasp, if any.
        """
        if code in WITH_ANOTHER_GRASP and self._grasps > 0 and grasp is not None:
            self._grasps -= 1
            missed = (*attempt.missed, grasp)
        elif code in WITH_A_NEW_LOOK and self._looks > 0:
            self._looks -= 1
            missed = attempt.missed
        else:
            self._failed_in_a_row = self._failed_in_a_row + 1 if code not in (None, Code.NO_OBJECT) else 0
            self._grasps, self._looks = self._settings.grasps, self._settings.looks
            return None
        return attempt.model_copy(
            update={"cycle_id": next_id, "number": attempt.number + 1, "retry_of": attempt.cycle_id, "missed": missed}
        )

    def holds(self) -> str:
        """The reason to hold now, which restarts the count; "" for none."""
        count = self._failed_in_a_row
        if not 0 < self._settings.hold_after <= count:
            return ""
        self._failed_in_a_row = 0
        failed = "A pick" if count == 1 else f"{count} picks in a row"
        return f"{failed} failed: look what is wrong, then `cell unhold` or `cell stop`."
