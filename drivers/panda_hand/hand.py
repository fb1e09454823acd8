"""The Franka hand as a `Hand`, over franky (it lets other threads run while the fingers move; pylibfranka does not).

What the makers say of it (libfranka issues 18, 52, 105, 111): a move onto something hard may hang for minutes, a stop
does not reliably interrupt one, and a stop lets go of what is held. So unknown objects are closed on with ``grasp``,
and nothing is ever stopped while it holds or is about to.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from bus.errors import DeviceLost, DriverError, DriverUnavailable, HandFault, NotConnected
from bus.messages import HandState
from bus.threads import OwnedThread, Role
from config.schema import Station
from drivers.interface import Devices
from drivers.motion.stops import Stops
from drivers.panda_hand.gripper import LOST_ADVICE, Gripper, load_franky

_log = logging.getLogger(__name__)
_STALE_S = 1.0
_SLOWEST_M_S = 0.001
_ROUNDING_M = 0.002
"""A width so far below zero is zero."""
_CLOSE_S = 5.0
_AGAIN_S = 1.0
_WIDTH_TRIES = 3
_STOP_TRIES = 3
_STOP_AGAIN_S = 0.1
"""A stop that comes before the hand itself has begun is lost on it: it is said again after so long."""


@dataclass(frozen=True)
class _Seen:
    """What the hand said last, and when: UTC, and by the monotonic clock."""

    width_m: float
    stamp_ns: int
    at_s: float


@dataclass(frozen=True)
class _UnderWay:
    """One command that the hand carries out."""

    gripping: bool
    ended: threading.Event = field(default_factory=threading.Event)


class PandaHand:
    """A Franka hand on an FR3. Its width is asked for by a thread of its own: each question takes up to 100 ms.

    Args:
        franky: gives the package of that name. ``utc_ns``: the clock of its stamps.
    """

    def __init__(
        self, station: Station, franky: Callable[[], Any] = load_franky, utc_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self._settings, self._widest_m = station.panda_hand, station.hand.max_width_m
        self._franky, self._utc_ns = franky, utc_ns
        self._gripper: Gripper | None = None
        self._homed = False
        self._acting = threading.Lock()
        self._turn = threading.Lock()  # held where a command begins, and where one is stopped
        self._under_way: _UnderWay | None = None
        self._stops = Stops()
        self._seen = _Seen(math.nan, 0, -math.inf)
        self._opens_to_m = math.inf
        self._trouble, self._counts = "", {"refusals": 0, "reconnects": 0}
        self._ending = threading.Event()
        self._poller: OwnedThread | None = None

    # --- life ---------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Raises: DriverUnavailable: no package, or no hand at that address; HandFault: it does not say its width."""
        if self._gripper is not None and self._poller is not None and self._poller.is_alive():
            return
        self.close()
        gripper = Gripper(self._settings.address, self._franky)
        self._learn_width(gripper)
        ending = threading.Event()  # of this thread alone: one that hangs in the package does not come back to life
        self._gripper, self._ending = gripper, ending
        self._poller = OwnedThread(Role.HAND_POLL, lambda: self._poll(ending)).start()

    def close(self) -> None:
        self._ending.set()
        self._stops.stop()
        poller, self._poller, self._gripper = self._poller, None, None
        if poller is not None:
            poller.join(_CLOSE_S)

    def _require(self) -> Gripper:
        gripper = self._gripper
        if gripper is None:
            raise NotConnected("The Franka hand is not connected.", "Call connect() first.")
        return gripper

    # --- state --------------------------------------------------------------------------------------------------------

    def state(self) -> HandState:
        """The width as last asked for. Raises: DeviceLost when the hand has not said one for a second."""
        self._require()
        poller, seen = self._poller, self._seen
        if poller is not None and not poller.is_alive():
            raise DeviceLost("The hand is no longer asked for its width: that ended by a defect.", "Restart its node.")
        if time.monotonic() - seen.at_s > _STALE_S:
            raise DeviceLost(f"The Franka hand does not answer any more. {self._trouble}".strip(), LOST_ADVICE)
        return HandState(
            stamp_ns=seen.stamp_ns,
            width_m=0.0 if -_ROUNDING_M < seen.width_m < 0 else seen.width_m,
            is_moving=self._under_way is not None,
            is_homed=self._homed,
        )

    def readings(self) -> dict[str, float]:
        """How old the width is, how often it was refused, and how often the hand was connected anew."""
        if self._gripper is None:
            return {}
        counts = {name: float(count) for name, count in self._counts.items()}
        return {"width_age_s": time.monotonic() - self._seen.at_s, **counts}

    def _poll(self, ending: threading.Event) -> None:
        """Until close: ask, whatever the hand says to it; a hand that is lost, or only refuses, is connected anew."""
        while not ending.wait(self._settings.poll_s):
            try:
                self._ask_width(self._require())
            except DriverError as error:
                if ending.is_set():
                    return
                self._counts["refusals"] += 1
                self._trouble = error.text
                _log.warning("%s", error)
                if isinstance(error, DeviceLost) or time.monotonic() - self._seen.at_s > _STALE_S:
                    self._reconnect(ending)

    def _learn_width(self, gripper: Gripper) -> None:
        """Ask until it says one, a few times: a refusal of this question says nothing of what it did before."""
        for _ in range(_WIDTH_TRIES - 1):
            try:
                return self._ask_width(gripper)
            except HandFault as error:
                _log.warning("%s", error)
            self._ending.wait(self._settings.poll_s)
        return self._ask_width(gripper)

    def _ask_width(self, gripper: Gripper) -> None:
        width_m, widest_m = gripper.widths_m()
        if self._homed and widest_m > 0:
            self._opens_to_m = widest_m
        self._seen = _Seen(width_m, self._utc_ns(), time.monotonic())

    def _reconnect(self, ending: threading.Event) -> None:
        """Until the hand is back, or close."""
        while not ending.wait(_AGAIN_S):
            try:
                gripper = Gripper(self._settings.address, self._franky)
            except DriverUnavailable as error:
                self._trouble = error.text
                continue
            if not ending.is_set():
                self._gripper, self._homed, self._opens_to_m = gripper, False, math.inf  # it may have been switched off
                self._counts["reconnects"] += 1
                _log.warning("the Franka hand is back")
            return

    # --- motion -------------------------------------------------------------------------------------------------------

    def home(self) -> HandState:
        """Close, open, and so find the widest opening; once after power-on. One that was stopped does not count."""
        if self._act(Gripper.homing, self._stops.asked(), gripping=False):
            self._homed = True
        return self.state()

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Each hand opens to a slightly different width, known after homing; fully open means that one."""
        stopped = self._stops.asked()
        if not (math.isfinite(width_m) and 0 <= width_m <= self._widest_m):
            raise HandFault(f"The hand cannot open to {width_m} m.", f"Ask for 0 to {self._widest_m} m.")
        finger_m_s = _finger_speed(speed_m_s)
        self._act(lambda gripper: gripper.move(min(width_m, self._opens_to_m), finger_m_s), stopped, gripping=False)
        return self.state()

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Close on whatever is there."""
        stopped = self._stops.asked()
        if not (math.isfinite(force_n) and force_n > 0):
            raise HandFault(f"The hand cannot grasp with {force_n} N.", "Ask for a positive force.")
        finger_m_s = _finger_speed(speed_m_s)
        self._act(lambda gripper: gripper.grasp(finger_m_s, force_n, self._widest_m), stopped, gripping=True)
        return self.state()

    def _act(self, act: Callable[[Gripper], bool], stopped: Callable[[], bool], *, gripping: bool) -> bool:
        """One command, and the width after it; False when it did not come to its end.

        A grasp of nothing is answered with False: the width tells.
        """
        self._require()
        with self._acting:
            under_way = _UnderWay(gripping)
            with self._turn:
                if stopped():
                    return False
                gripper, self._under_way = self._require(), under_way
            try:
                done = act(gripper)
            except HandFault:
                if gripping or not stopped():
                    raise
                done = False  # how a stop ends it
            finally:
                self._under_way = None
                under_way.ended.set()
            self._learn_width(gripper)
        if not (done or gripping or stopped()):
            raise HandFault("The hand did not do what was asked.", "Is something between the fingers? Home it again.")
        return done

    def stop(self) -> None:
        """Stop an empty hand's move; a grasp is left alone, under way or done: a stop would let go."""
        with self._turn:
            self._stops.stop()
            stopping = self._under_way
        for _ in range(_STOP_TRIES):
            with self._turn:
                gripper = self._gripper
                if stopping is None or stopping.gripping or self._under_way is not stopping or gripper is None:
                    return
                _send_stop(gripper)
            if stopping.ended.wait(_STOP_AGAIN_S):
                return


def _send_stop(gripper: Gripper) -> None:
    try:
        gripper.stop()
    except DriverError as error:  # a stop never raises; whoever stops looks at the width
        _log.error("hand stop: %s", error)


def _finger_speed(speed_m_s: float) -> float:
    """Franka counts the speed of one finger, we that of the width."""
    if not (math.isfinite(speed_m_s) and speed_m_s > 0):
        raise HandFault(f"The hand cannot move at {speed_m_s} m/s.", "Ask for a positive speed.")
    return max(speed_m_s / 2, _SLOWEST_M_S)


def open_devices(station: Station) -> Devices:
    """What the driver registry loads under the name ``panda_hand``."""
    return Devices(hand=PandaHand(station))
