"""Calls of another package's plug-in: each on its own thread, with a deadline, and what it raises named as its own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from bus.cancel import Cancel
from bus.codes import ADVICE, Code
from bus.errors import CycleFailure
from bus.redaction import quoted, raised
from perception.models.calls import Call, GivenUp

_log = logging.getLogger(__name__)
ResultT = TypeVar("ResultT")


@dataclass(frozen=True)
class Rules:
    """The consequences of a plug-in's call that fails, or comes late.

    Attributes:
        whose: the plug-in in words, e.g. ``The detector 'acme'``.
        failed: the code when it raises. ``late``: when it gives no answer in time.
        may_say: codes that it may end a cycle with by itself; of others some abort the cell.
        package: that brings it, with its version; "" = unknown.
    """

    whose: str
    failed: Code
    late: Code
    may_say: frozenset[Code]
    package: str = ""

    def refused(self, what: str) -> CycleFailure:
        """Return the failure of a call with an unusable answer; ``what`` begins with a verb and has no full stop."""
        return self.packaged(CycleFailure(self.failed, f"{self.whose} {what}."))

    def too_late(self, what: str) -> CycleFailure:
        """Return the failure of a call without an answer in time; ``what`` as of `refused`."""
        return self.packaged(CycleFailure(self.late, f"{self.whose} {what}."))

    def packaged(self, failure: CycleFailure) -> CycleFailure:
        """Return the failure; its advice names the package where the plug-in is to blame.

        A replay compares the reason, so that the version stands in the advice.
        """
        if self.package and failure.failure in (self.failed, self.late):
            failure.advice = f"{ADVICE[failure.failure]} The plug-in comes with {self.package}."
        return failure


class PlugInCalls:
    """Calls one plug-in, which runs once at a time.

    Args:
        deadline_s: of a call; None = none, and on the caller's thread.
    """

    def __init__(self, rules: Rules, deadline_s: float | None) -> None:
        self._rules, self._deadline_s = rules, deadline_s
        self._left_behind: Call[Any] | None = None

    @property
    def is_busy(self) -> bool:
        """True while a call runs for which nobody waits any more."""
        return self._left_behind is not None and not self._left_behind.is_over

    def ask(self, work: Callable[[Cancel], ResultT], cancel: Cancel) -> ResultT:
        """Return the result of ``work``, which is given a stop request of its own.

        Raises: CycleFailure(STOPPED), with the codes of the rules, or the one that the plug-in raises.
        """
        if self._deadline_s is None:
            return self._named(work, cancel)
        rules, stop = self._rules, Cancel()
        if self.is_busy:
            raise rules.too_late("is still busy with a scene that nobody waits for any more")
        call: Call[ResultT] = Call(lambda: self._named(work, stop), lambda _: None, rules.whose)
        try:
            return call.wait(self._deadline_s, cancel)
        except GivenUp:
            self._left_behind = call
            stop.set()
            cancel.raise_if_set("detect")
            raise rules.too_late(f"gave no answer within {self._deadline_s:g} s") from None

    def close(self, work: Callable[[], None]) -> None:
        """Close the plug-in; one that is still busy, or fails to close, is left behind."""
        if self.is_busy:
            return
        try:
            self.ask(lambda _: work(), Cancel())
        except CycleFailure as failure:
            _log.warning("%s It was to be closed.", failure.text)

    def _named(self, work: Callable[[Cancel], ResultT], cancel: Cancel) -> ResultT:
        """Return the result of ``work``; what it raises, `SystemExit` too, becomes a failure that names the plug-in."""
        try:
            return work(cancel)
        except CycleFailure as failure:
            if failure.failure in self._rules.may_say:
                raise
            text = f"ended with {failure.failure}: {quoted(failure.text).rstrip('.')}"
            raise self._rules.refused(text) from failure
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt) and threading.current_thread() is threading.main_thread():
                raise  # Ctrl-C of a person
            _log.warning("%s failed", self._rules.whose, exc_info=True)  # its author wants to know where
            raise self._rules.refused(f"failed: {raised(error)}") from error
