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
    HOLD = "hold"
    STOP = "stop"


class Stream:
    """The 1 kHz commands of one trajectory.

    `hold`, `resume` and `brake` may be called from any thread, and repeatedly; `next` from one thread.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._progress = Progress(trajectory.filtered(), trajectory.window)
        self._want = _Want.PLAY
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
        return self._want is _Want.HOLD and self._begun and self._progress.at_rest

    @property
    def is_held_or_about_to_be(self) -> bool:
        """Whether `hold` was the last request."""
        return self._want is _Want.HOLD

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
        self._progress.advance(target_rate=1.0 if self._want is _Want.PLAY else 0.0)
        return self._progress.q_rad()

    def _ask(self, want: _Want) -> None:
        with self._asking:
            if self._want is not _Want.STOP:
                self._want = want
