"""Plays a trajectory tick by tick; stops, holds and resumes on its path. Every arm uses it.

The filtered samples are played exactly. A hold or stop slows the *progress* along them: at rate r the arm is where the
planned motion is, only later, so no command leaves the checked path.
"""

from __future__ import annotations

import threading
from enum import Enum

from bus.arrays import Joints
from bus.trajectory import Trajectory
from config.limits import JointLimits
from drivers.motion.contact import Feeler
from drivers.motion.progress import Progress

_CLEAR_RAD = 0.001
"""An arm that met something goes back by so much of its fastest joint, 0.3 to 0.6 mm: then the friction in its
joints does not keep it pressing."""


class _Want(Enum):
    PLAY = "play"
    WAIT = "wait"
    HOLD = "hold"
    STOP = "stop"


class Stream:
    """The 1 kHz commands of one trajectory.

    One with ``waits_at`` comes to rest before that tick and is held there, until `resume`, which may come earlier.
    Until then its progress has full speed: a hold ends by `resume`, too.
    One with a ``guard`` brakes for good when it meets something there, and goes back to just before, so that it does
    not go on pressing; its driver tells the torques to `feel`.
    `hold`, `resume` and `brake` may be called from any thread, and repeatedly; `next` and `feel` from one thread.

    Args:
        limits: of the arm's joints.

    Attributes:
        contact_n: the force at which its guard braked it; None = it met nothing.
    """

    def __init__(self, trajectory: Trajectory, limits: JointLimits) -> None:
        samples_rad = trajectory.filtered()
        self._progress = Progress(limits, samples_rad, trajectory.window)
        self._feeler = Feeler(trajectory.guard, len(samples_rad) - 1)
        self.contact_n: float | None = None
        self._want, self._slows_at = _Want.PLAY, 0.0
        if trajectory.waits_at is not None:
            self._want, self._slows_at = _Want.WAIT, self._progress.last_start_of_a_stop(trajectory.waits_at)
        self._asking = threading.Lock()
        self._begun = False
        self._over = False

    @property
    def finished(self) -> bool:
        """Whether the trajectory was played to its end."""
        return self._over and self._progress.at_end and self.contact_n is None

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

    @property
    def is_felt(self) -> bool:
        """Whether the motion is guarded here, and under way: the torques of this tick are to be told to `feel`."""
        is_under_way = self._begun and not self._over and self._want in (_Want.PLAY, _Want.WAIT)
        return is_under_way and self._feeler.is_due(self._progress.at)

    def feel(self, tau_ext_nm: Joints) -> None:
        """Brake for good, harder than `brake`, when these external torques (joints,) are contact; once a tick."""
        contact_n = self._feeler.contact_n(self._progress.at, tau_ext_nm)
        if contact_n is None:
            return
        with self._asking:
            if self._want in (_Want.PLAY, _Want.WAIT):
                self._want, self.contact_n = _Want.STOP, contact_n

    def next(self) -> Joints | None:
        """Return the next command (joints,) [rad], one tick (1 ms) after the last; None once at rest for good."""
        if self._over:
            return None
        if not self._begun:
            self._begun = True
            return self._progress.q_rad()
        if self._progress.at_end or (self._want is _Want.STOP and self._progress.at_rest):
            if self.contact_n is None or not self._progress.go_back(self._feeler.since_at, _CLEAR_RAD):
                self._over = True
                return None
            return self._progress.q_rad()
        goes_on = self._want is _Want.PLAY or (self._want is _Want.WAIT and self._progress.at < self._slows_at)
        self._progress.advance(target_rate=1.0 if goes_on else 0.0, hard=self.contact_n is not None)
        return self._progress.q_rad()

    def _ask(self, want: _Want) -> None:
        with self._asking:
            if self._want is not _Want.STOP:
                self._want = want
