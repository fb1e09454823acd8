"""The Franka hand as a `Hand`, over franky (it lets other threads run while the fingers move; pylibfranka does not).

What the makers say of it (libfranka issues 18, 52, 105, 111): a move onto something hard may hang for minutes, a stop
does not reliably interrupt one, and a stop lets go of what is held. So unknown objects are closed on with ``grasp``,
and nothing is ever stopped while it holds or is about to.
"""

from __future__ import annotations

import importlib
import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from bus.errors import DeviceLost, DriverUnavailable, HandFault, NotConnected
from bus.messages import HandState
from config.schema import Station
from drivers.interface import Devices

_log = logging.getLogger(__name__)
_STALE_S = 1.0
_SLOWEST_M_S = 0.001
_LOST_ADVICE = "Check the arm's power and network; when it is back, `cell clear` and `cell reset`."


class PandaHand:
    """A Franka hand on an FR3. Its width is asked for by a thread of its own: each question takes up to 100 ms."""

    def __init__(self, station: Station) -> None:
        self._settings, self._widest_m = station.panda_hand, station.hand.max_width_m
        self._gripper: Any = None
        self._homed = self._moving = self._gripping = False
        self._acting = threading.Lock()
        self._width_m, self._opens_to_m, self._seen_ns = math.nan, math.inf, 0
        self._ending = threading.Event()
        self._poller: threading.Thread | None = None

    # --- life ---------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Raises: DriverUnavailable: no package, or no hand at that address."""
        if self._gripper is not None:
            return
        self._gripper = _open(self._settings.address)
        self._ask_width()
        self._ending.clear()
        self._poller = threading.Thread(target=self._poll, daemon=True)
        self._poller.start()

    def close(self) -> None:
        self._ending.set()
        poller, self._poller, self._gripper = self._poller, None, None
        if poller is not None:
            poller.join(timeout=5.0)

    def _require(self) -> Any:
        gripper = self._gripper
        if gripper is None:
            raise NotConnected("The Franka hand is not connected.", "Call connect() first.")
        return gripper

    # --- state --------------------------------------------------------------------------------------------------------

    def state(self) -> HandState:
        """The width as last asked for. Raises: DeviceLost when the hand has not answered for a second."""
        self._require()
        if (time.time_ns() - self._seen_ns) / 1e9 > _STALE_S:
            raise DeviceLost("The Franka hand does not answer any more.", _LOST_ADVICE)
        return HandState(
            stamp_ns=self._seen_ns, width_m=max(0.0, self._width_m), is_moving=self._moving, is_homed=self._homed
        )

    def _poll(self) -> None:
        while not self._ending.wait(self._settings.poll_s):
            try:
                self._ask_width()
            except DeviceLost as error:
                _log.warning("%s", error)
                self._reconnect()
            except NotConnected:
                return

    def _ask_width(self) -> None:
        with _mapped():
            now = self._require().state
            self._width_m = float(now.width)
            if self._homed and now.max_width > 0:
                self._opens_to_m = float(now.max_width)
        self._seen_ns = time.time_ns()

    def _reconnect(self) -> None:
        """Until the hand is back, or close."""
        while not self._ending.wait(1.0):
            try:
                self._gripper = _open(self._settings.address)
            except DriverUnavailable:
                continue
            self._homed = False  # it may have been switched off
            _log.warning("the Franka hand is back")
            return

    # --- motion -------------------------------------------------------------------------------------------------------

    def home(self) -> HandState:
        """Close, open, and so find the widest opening; once after power-on."""
        self._act(lambda gripper: gripper.homing(), gripping=False)
        self._homed = True
        return self.state()

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Each hand opens to a slightly different width, known after homing; fully open means that one."""
        if not (math.isfinite(width_m) and 0 <= width_m <= self._widest_m):
            raise HandFault(f"The hand cannot open to {width_m} m.", f"Ask for 0 to {self._widest_m} m.")
        finger_m_s = _finger_speed(speed_m_s)
        self._act(lambda gripper: gripper.move(min(width_m, self._opens_to_m), finger_m_s), gripping=False)
        return self.state()

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Close on whatever is there: every final width counts as grasped, so that the force is kept."""
        if not (math.isfinite(force_n) and force_n > 0):
            raise HandFault(f"The hand cannot grasp with {force_n} N.", "Ask for a positive force.")
        finger_m_s = _finger_speed(speed_m_s)
        self._act(
            lambda gripper: gripper.grasp(0.0, finger_m_s, force_n, self._widest_m, self._widest_m), gripping=True
        )
        return self.state()

    def _act(self, act: Callable[[Any], bool], *, gripping: bool) -> None:
        """One command, and the width after it. A grasp of nothing is answered with False: the width tells."""
        gripper = self._require()
        with self._acting, _mapped():
            self._moving, self._gripping = True, gripping
            try:
                done = act(gripper)
            finally:
                self._moving = False
            self._ask_width()
        if not (done or gripping):
            raise HandFault("The hand did not do what was asked.", "Is something between the fingers? Home it again.")

    def stop(self) -> None:
        """Stop an empty hand's move; a grasp is left alone, under way or done: a stop would let go."""
        gripper = self._gripper
        if gripper is None or not self._moving or self._gripping:
            return
        try:
            with _mapped():
                gripper.stop()
        except (HandFault, DeviceLost) as error:  # a stop never raises; whoever stops looks at the width
            _log.error("hand stop: %s", error)


def _finger_speed(speed_m_s: float) -> float:
    """Franka counts the speed of one finger, we that of the width."""
    if not (math.isfinite(speed_m_s) and speed_m_s > 0):
        raise HandFault(f"The hand cannot move at {speed_m_s} m/s.", "Ask for a positive speed.")
    return max(speed_m_s / 2, _SLOWEST_M_S)


def _open(address: str) -> Any:
    try:
        franky = importlib.import_module("franky")
    except ImportError as error:
        raise DriverUnavailable(f"franky cannot be imported: {error}.", "uv pip install -e '.[fr3]'") from error
    try:
        return franky.Gripper(address)
    except franky.Exception as error:
        raise DriverUnavailable(
            f"The Franka hand at {address} cannot be reached: {' '.join(str(error).split())}.",
            "Check power and panda_hand.address; in Desk the End Effector must be the Franka Hand, and FCI active.",
        ) from error


@contextmanager
def _mapped() -> Iterator[None]:
    """libfranka's errors as ours."""
    franky = importlib.import_module("franky")
    try:
        yield
    except (franky.NetworkException, RuntimeError) as error:  # a dead connection is at times only a "Net Exception"
        raise DeviceLost(f"The hand was lost: {' '.join(str(error).split())}.", _LOST_ADVICE) from error
    except franky.Exception as error:
        said = " ".join(str(error).replace("libfranka gripper:", "").split())
        raise HandFault(f"The hand refused: {said}", "Home it again with `cell reset`.") from error


def open_devices(station: Station) -> Devices:
    """What the driver registry loads under the name ``panda_hand``."""
    return Devices(hand=PandaHand(station))
