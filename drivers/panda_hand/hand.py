"""The Franka hand as a `Hand`, over franky (other threads run while the fingers move; with pylibfranka they do not).

According to its makers (libfranka issues 18, 52, 105, 111), a move onto something hard may hang for minutes, a stop
does not reliably interrupt one, and a stop releases a held object. So unknown objects are closed on with ``grasp``, and
the hand is never stopped while it holds an object or is about to.
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
"""A measured width down to minus this is zero."""
_CLOSE_S = 5.0
_AGAIN_S = 1.0
_WIDTH_TRIES = 3
_STOP_TRIES = 3
_STOP_AGAIN_S = 0.1
"""A stop is lost when the hand itself has not begun yet, so it is repeated after this time."""


@dataclass(frozen=True)
class _Seen:
    """The newest width and its time: UTC, and by the monotonic clock."""

    width_m: float
    stamp_ns: int
    at_s: float


@dataclass(frozen=True)
class _UnderWay:
    """One command that the hand carries out."""

    gripping: bool
    ended: threading.Event = field(default_factory=threading.Event)


class PandaHand:
    """A Franka hand on an FR3. A thread of its own reads the width, because each reading takes up to 100 ms.

    Args:
        station: ``panda_hand`` and ``hand.max_width_m`` are used.
        franky: imports the package of that name. ``utc_ns``: the clock of its stamps.
    """

    def __init__(
        self, station: Station, franky: Callable[[], Any] = load_franky, utc_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self._settings, self._widest_m = station.panda_hand, station.hand.max_width_m
        self._franky, self._utc_ns = franky, utc_ns
        self._gripper: Gripper | None = None
        self._homed = False
        self._acting = threading.Lock()
        self._turn = threading.Lock()  # held while a command begins, and while one is stopped
        self._under_way: _UnderWay | None = None
        self._stops = Stops()
        self._seen = _Seen(math.nan, 0, -math.inf)
        self._opens_to_m = math.inf
        self._trouble, self._counts = "", {"refusals": 0, "reconnects": 0}
        self._ending = threading.Event()
        self._poller: OwnedThread | None = None

    # --- life ---------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Connect and start reading the width.

        Raises:
            DriverUnavailable: no package, or no hand at that address.
            HandFault: the hand does not tell its width.
        """
        if self._gripper is not None and self._poller is not None and self._poller.is_alive():
            return
        self.close()
        gripper = Gripper(self._settings.address, self._franky)
        self._learn_width(gripper)
        ending = threading.Event()  # of this thread alone, so that an older one that hung in the package stays ended
        self._gripper, self._ending = gripper, ending
        self._poller = OwnedThread(Role.HAND_POLL, lambda: self._poll(ending)).start()

    def close(self) -> None:
        """Stop and disconnect; idempotent."""
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
        """Return the newest state.

        Raises:
            NotConnected: before `connect` and after `close`.
            DeviceLost: no width came for a second, or the reading thread ended.
        """
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
        """Return the age of the width, and the numbers of refused readings and reconnections."""
        if self._gripper is None:
            return {}
        counts = {name: float(count) for name, count in self._counts.items()}
        return {"width_age_s": time.monotonic() - self._seen.at_s, **counts}

    def _poll(self, ending: threading.Event) -> None:
        """Read the width until close; a hand that is lost, or only refuses, is connected anew."""
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
        """Read the width, with a few retries: a refused reading says nothing about the command before it."""
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
        """Try until the hand is back, or close."""
        while not ending.wait(_AGAIN_S):
            try:
                gripper = Gripper(self._settings.address, self._franky)
            except DriverUnavailable as error:
                self._trouble = error.text
                continue
            if not ending.is_set():
                self._gripper, self._homed, self._opens_to_m = gripper, False, math.inf  # it may have lost power
                self._counts["reconnects"] += 1
                _log.warning("the Franka hand is back")
            return

    # --- motion -------------------------------------------------------------------------------------------------------

    def home(self) -> HandState:
        """Close and open to find the widest opening; once after power-on. A stopped homing does not count.

        Raises: HandFault, DeviceLost, NotConnected.
        """
        if self._act(Gripper.homing, self._stops.asked(), gripping=False):
            self._homed = True
        return self.state()

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Move to ``width_m`` at ``speed_m_s``, the rate of the width.

        Each hand opens to a slightly different width, known after homing; a wider request means that one.

        Raises:
            HandFault: width or speed is out of range, or the hand did not get there.
            DeviceLost: the hand does not answer.
            NotConnected: before `connect` and after `close`.
        """
        stopped = self._stops.asked()
        if not (math.isfinite(width_m) and 0 <= width_m <= self._widest_m):
            raise HandFault(f"The hand cannot open to {width_m} m.", f"Ask for 0 to {self._widest_m} m.")
        finger_m_s = _finger_speed(speed_m_s)
        self._act(lambda gripper: gripper.move(min(width_m, self._opens_to_m), finger_m_s), stopped, gripping=False)
        return self.state()

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Close on any object at ``speed_m_s``, the rate of the width, and keep pressing with ``force_n``.

        Raises: as `move`; a grasp of nothing is no error, the width tells.
        """
        stopped = self._stops.asked()
        if not (math.isfinite(force_n) and force_n > 0):
            raise HandFault(f"The hand cannot grasp with {force_n} N.", "Ask for a positive force.")
        finger_m_s = _finger_speed(speed_m_s)
        self._act(lambda gripper: gripper.grasp(finger_m_s, force_n, self._widest_m), stopped, gripping=True)
        return self.state()

    def _act(self, act: Callable[[Gripper], bool], stopped: Callable[[], bool], *, gripping: bool) -> bool:
        """Carry out one command, then read the width; return False when the command did not complete.

        A grasp of nothing returns False; the width tells.
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
                done = False  # a stopped command ends by a HandFault
            finally:
                self._under_way = None
                under_way.ended.set()
            self._learn_width(gripper)
        if not (done or gripping or stopped()):
            raise HandFault("The hand did not do what was asked.", "Is something between the fingers? Home it again.")
        return done

    def stop(self) -> None:
        """Stop an empty hand's move; a grasp is left alone, running or done, because a stop would release it."""
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
    except DriverError as error:  # a stop never raises; the caller checks the width
        _log.error("hand stop: %s", error)


def _finger_speed(speed_m_s: float) -> float:
    """Convert the width's rate to the speed of one finger, which Franka counts. Raises: HandFault unless positive."""
    if not (math.isfinite(speed_m_s) and speed_m_s > 0):
        raise HandFault(f"The hand cannot move at {speed_m_s} m/s.", "Ask for a positive speed.")
    return max(speed_m_s / 2, _SLOWEST_M_S)


def open_devices(station: Station) -> Devices:
    """Make the devices of driver ``panda_hand``; entry point of the driver registry."""
    return Devices(hand=PandaHand(station))
