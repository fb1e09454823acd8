"""One call of another package's detector: on its own thread, with a deadline, checked, and recorded as a reply."""

from __future__ import annotations

import time
from collections.abc import Callable

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import ModelReply
from bus.redaction import quoted
from perception.detectors.base import FoundGrasp, GraspDetector, SeenScene
from perception.detectors.checked import checked
from perception.detectors.written import written
from perception.models.calls import Call, GivenUp

_MAY_SAY = frozenset(
    {
        Code.NO_GRASP,
        Code.NOT_SEEN,
        Code.NO_DEPTH,
        Code.TARGET_NOT_FOUND,
        Code.DETECTOR_FAILED,
        Code.DETECTOR_TIMEOUT,
        Code.STOPPED,
    }
)
"""Codes that a detector may end a cycle with by itself; of others some abort the cell."""


class DetectorCall:
    """Asks one detector, which runs once at a time.

    Args:
        name: as the station names it. ``deadline_s``: of a call; None = none, and on the caller's thread.
    """

    def __init__(self, name: str, detector: GraspDetector, deadline_s: float | None) -> None:
        self.name = name
        self._detector, self._deadline_s = detector, deadline_s
        self._running: Call[object] | None = None

    def ask(self, seen: SeenScene, on_reply: Callable[[ModelReply], None], cancel: Cancel) -> tuple[FoundGrasp, ...]:
        """Its grasps.

        Args:
            on_reply: called with the record of the call, successful or not.

        Raises: CycleFailure(DETECTOR_FAILED, DETECTOR_TIMEOUT, STOPPED), or the one that the detector raises.
        """
        began_s, found, failure = time.monotonic(), tuple[FoundGrasp, ...](), None
        try:
            cancel.raise_if_set("detect")
            found = checked(self.name, self._called(seen, cancel), seen)
        except CycleFailure as error:
            failure = error
        on_reply(
            ModelReply(
                step="detect",
                model=self.name,
                prompt=f"Grasps on the things {', '.join(map(str, seen.targets))}, in looks: {len(seen.looks)}.",
                text=written(found, is_deterministic=bool(self._detector.is_deterministic)),
                failure=None if failure is None else failure.failure,
                text_of_failure="" if failure is None else failure.text,
                latency_s=time.monotonic() - began_s,
            )
        )
        if failure is not None:
            raise failure
        return found

    def close(self) -> None:
        """Close the detector; one that is still busy is left behind."""
        if self._running is None or self._running.is_over:
            self._detector.close()

    def _called(self, seen: SeenScene, cancel: Cancel) -> object:
        try:
            if self._deadline_s is None:
                return self._detector.detect(seen, cancel)
            return self._in_time(seen, cancel, self._deadline_s)
        except CycleFailure as failure:
            if failure.failure in _MAY_SAY:
                raise
            what = f"The detector {self.name!r} ended with {failure.failure}: {quoted(failure.text)}"
            raise CycleFailure(Code.DETECTOR_FAILED, what) from failure
        except Exception as error:
            what = f"The detector {self.name!r} failed: {type(error).__name__}: {quoted(str(error))}."
            raise CycleFailure(Code.DETECTOR_FAILED, what) from error

    def _in_time(self, seen: SeenScene, cancel: Cancel, deadline_s: float) -> object:
        if self._running is not None and not self._running.is_over:
            what = f"The detector {self.name!r} is still busy with a scene that nobody waits for any more."
            raise CycleFailure(Code.DETECTOR_TIMEOUT, what)
        stop = Cancel()
        call: Call[object] = Call(lambda: self._detector.detect(seen, stop), lambda _: None, self.name)
        self._running = call
        try:
            return call.wait(deadline_s, cancel)
        except GivenUp:
            stop.set()
            cancel.raise_if_set("detect")
            what = f"The detector {self.name!r} gave no answer within {deadline_s:g} s."
            raise CycleFailure(Code.DETECTOR_TIMEOUT, what) from None
