"""One call of another package's detector: with a deadline, checked, and recorded as a reply."""

from __future__ import annotations

import time
from collections.abc import Callable

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import ModelReply
from perception.detectors.base import FoundGrasp, GraspDetector, SeenScene
from perception.detectors.checked import checked
from perception.detectors.written import written
from perception.models.plug_in_calls import PlugInCalls, Rules

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
        name: as the station names it. ``package``: that brings it, with its version.
        deadline_s: of a call; None = none, and on the caller's thread.
    """

    def __init__(self, name: str, detector: GraspDetector, deadline_s: float | None, package: str = "") -> None:
        self.name, self._detector = name, detector
        whose = f"The detector {name!r}"
        self._rules = Rules(whose, Code.DETECTOR_FAILED, Code.DETECTOR_TIMEOUT, _MAY_SAY, package)
        self._calls = PlugInCalls(self._rules, deadline_s)

    def ask(self, seen: SeenScene, on_reply: Callable[[ModelReply], None], cancel: Cancel) -> tuple[FoundGrasp, ...]:
        """Its grasps.

        Args:
            on_reply: called with the record of the call, successful or not.

        Raises: CycleFailure(DETECTOR_FAILED, DETECTOR_TIMEOUT, STOPPED), or the one that the detector raises.
        """
        began_s, found, failure = time.monotonic(), tuple[FoundGrasp, ...](), None
        try:
            cancel.raise_if_set("detect")
            found = checked(self.name, self._calls.ask(lambda stop: self._detector.detect(seen, stop), cancel), seen)
        except CycleFailure as error:
            failure = self._rules.packaged(error)
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
        self._calls.close(self._detector.close)
