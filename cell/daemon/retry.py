"""The retry policy of a failed pick: the next ranked grasp, then a new capture, and after too many failures a hold.

A job that may clear its way goes on in the same manner: what lies on its target is picked in a cycle of its own first.

Each attempt is a cycle of its own, with its own recording: it captures and detects anew, because the failure may have
moved the object, and leaves out the grasps that missed before. A fault of a device is never retried.
"""

from __future__ import annotations

from bus.arrays import Transform, Vector3
from bus.codes import Code
from bus.messages import Attempt, EarlierAttempt, Job, Target
from config.pick import RetrySettings

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
        Code.MODEL_FAILED,
        Code.DETECTOR_FAILED,
        Code.DETECTOR_TIMEOUT,
    }
)
"""Codes for which a new capture may help. Causes that only a person can remove (key, quota, spend limit) are left out.
"""


_MOST_CLEARED = 5
"""Most things that are taken off one target."""


class Retries:
    """The attempts left for the current object, and the number of objects that failed in a row."""

    def __init__(self, settings: RetrySettings) -> None:
        self._settings = settings
        self._grasps, self._looks = settings.grasps, settings.looks
        self._failed_in_a_row = 0

    def after(
        self,
        attempt: Attempt,
        code: Code | None,
        grasp: Transform | None,
        next_id: str,
        reason: str = "",
        obstacle_m: Vector3 | None = None,
    ) -> Attempt | None:
        """Return the attempt ``next_id`` that follows ``attempt``; None for no further one.

        Args:
            code: of the end of ``attempt``; None = success. ``reason``: in words.
            grasp: base_from_tcp (4, 4) of the executed grasp, if any.
            obstacle_m: (3,) top of what lies on the target, in ``base``.
        """
        changed: dict[str, object]
        if code is Code.OBSTRUCTED and obstacle_m is not None and self._may_clear(attempt):
            changed = {"job": _clearing(attempt.job, obstacle_m), "then": (attempt.job, *attempt.then), "missed": ()}
        elif code is None and attempt.then:
            changed = {"job": attempt.then[0], "then": attempt.then[1:], "missed": ()}
        else:
            missed = self._missed_after(attempt, code, grasp)
            if missed is None:
                return None
            changed = {"missed": missed}
        earlier = (*attempt.earlier, EarlierAttempt(cycle_id=attempt.cycle_id, code=code, reason=reason))
        changed |= {"cycle_id": next_id, "number": attempt.number + 1, "retry_of": attempt.cycle_id, "earlier": earlier}
        return attempt.model_copy(update=changed)

    def _may_clear(self, attempt: Attempt) -> bool:
        asked = attempt.then[-1] if attempt.then else attempt.job
        cleared = sum(one.code is Code.OBSTRUCTED for one in attempt.earlier)
        return asked.clear_way and cleared < _MOST_CLEARED

    def _missed_after(
        self, attempt: Attempt, code: Code | None, grasp: Transform | None
    ) -> tuple[Transform, ...] | None:
        """The grasps that a retry leaves out; None for no retry."""
        if code in WITH_ANOTHER_GRASP and self._grasps > 0 and grasp is not None:
            self._grasps -= 1
            return (*attempt.missed, grasp)
        if code in WITH_A_NEW_LOOK and self._looks > 0:
            self._looks -= 1
            return attempt.missed
        self._failed_in_a_row = self._failed_in_a_row + 1 if code not in (None, Code.NO_OBJECT) else 0
        self._grasps, self._looks = self._settings.grasps, self._settings.looks
        return None

    def holds(self) -> str:
        """Return the reason to hold now, which restarts the count; "" for none."""
        count = self._failed_in_a_row
        if not 0 < self._settings.hold_after <= count:
            return ""
        self._failed_in_a_row = 0
        failed = "A pick" if count == 1 else f"{count} picks in a row"
        return f"{failed} failed: look what is wrong, then `cell unhold` or `cell stop`."


def _clearing(job: Job, obstacle_m: Vector3) -> Job:
    """The job that takes away what lies on the target of ``job``; it is laid into the station's tray."""
    x, y, z = (float(value) for value in obstacle_m)
    return Job(job_id=job.job_id, target=Target(point_m=(x, y, z)), grasp=job.grasp)
