"""Plays a trajectory tick by tick; stops, holds and resumes on its path. Every arm uses it.

The filtered samples are played exactly. A hold or stop slows the *progress* along them: at rate r the arm is where the
planned motion is, only later, so no command leaves the checked path.
"""

from __future__ import annotations

import threading
from enum import Enum

from bus.arrays import Joints
from bus.trajectory import Trajectory
from drivers.motion.progress import Progress


class _Want(Enum):
    PLAY = "play"
    WAIT = "wait"
    HOLD = "hold"
    STOP = "stop"


class Stream:
    """The 1 kHz commands of one trajectory.

    One with ``waits_at`` comes to rest before that tick and is held there, until `resume`, which may come earlier.
    Until then its progress has full speed: a hold ends by `resume`, too.
    `hold`, `resume` and `brake` may be called from any thread, and repeatedly; `next` from one thread.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._progress = Progress(trajectory.filtered(), trajectory.window)
        self._want, self._slows_at = _Want.PLAY, 0.0
        if trajectory.waits_at is not None:
            self._want, self._slows_at = _Want.WAIT, self._progress.last_start_of_a_stop(trajectory.waits_at)
        self._asking = threading.Lock()
        self._begun = False
        self._over = False

    @property
    def finished(self) -> bool:
        """Whether the trajectory was played to its end."""
        return self._over and self._progress.at_end

    @property
    def held(self) -> bool:
        """Whether the motion rests on its path and waits for `resume`."""
        return self.is_held_or_about_to_be and self._begun and self._progress.at_rest

    @property
    def is_held_or_about_to_be(self) -> bool:
        """Whether `hold` was the last request, or it waits by itself."""
        return self._want in (_Want.HOLD, _Want.WAIT)

    @property
    def is_braked(self) -> bool:
        """Whether `brake` was called."""
        return self._want is _Want.STOP

    def hold(self) -> None:
        """Come to rest on the path and wait there; `next` repeats the same command."""
        self._ask(_Want.HOLD)

    def resume(self) -> None:
        """Continue to the end, after a `hold`."""
        self._ask(_Want.PLAY)

    def brake(self) -> None:
        """Come to rest on the path for good."""
        self._ask(_Want.STOP)

    def next(self) -> Joints | None:
        """Return the next command (7,) [rad], one tick (1 ms) after the last; None once at rest for good."""
        if self._over:
            return None
        if not self._begun:
            self._begun = True
            return self._progress.q_rad()
        if self._progress.at_end or (self._want is _Want.STOP and self._progress.at_rest):
            self._over = True
            return None
        goes_on = self._want is _Want.PLAY or (self._want is _Want.WAIT and self._progress.at < self._slows_at)
        self._progress.advance(target_rate=1.0 if goes_on else 0.0)
        return self._progress.q_rad()

    def _ask(self, want: _Want) -> None:
        with self._asking:
            if self._want is not _Want.STOP:
                self._want = want
