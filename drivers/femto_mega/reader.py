"""The thread that reads a Femto Mega: keeps the newest usable pair, and reconnects when there is none."""

from __future__ import annotations

import logging
import math
import operator
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bus.errors import DriverUnavailable
from bus.threads import OwnedThread, Role
from config.hardware import FemtoMegaSettings
from drivers.femto_mega.clock import DeviceClock
from drivers.femto_mega.exposure import Settled
from drivers.femto_mega.session import UNREADABLE, Pair, Session, TornFrame
from drivers.rate import Rate

_log = logging.getLogger(__name__)
_HALF_EXPOSURE_NS = 6_400_000
"""Half of NFOV unbinned's nine pulses in 12.8 ms; the device stamps their beginning."""
READY_S = 10.0
"""Time for the exposure to settle and the clock to be learnt; a camera without a usable frame for so long is lost."""
_READ_S = 0.2
_AGAIN_S = 0.5
_FEEL_S = 5.0
_SAY_S = 10.0
_END_S = 5.0
_TORN_RUN = 30
"""So many unusable frames in a row (one second) end the session."""


@dataclass(frozen=True)
class Seen:
    """A usable pair.

    Attributes:
        session: the session whose calibration applies. ``exposed_ns``: middle of the exposure by the monotonic clock.
        stamp_ns: the same in UTC.
    """

    pair: Pair
    session: Session
    exposed_ns: int
    stamp_ns: int


class Reader:
    """Reads from ``session`` in a thread of its own, until ended.

    Args:
        reopen: opens another session. Raises: DriverUnavailable.

    Attributes:
        trouble: the problem of the newest frame, or the reason why none comes; "" while frames are good.
    """

    def __init__(self, session: Session, reopen: Callable[[], Session], settings: FemtoMegaSettings) -> None:
        self._reopen, self._settings = reopen, settings
        self._ending = threading.Event()
        self._news = threading.Condition()  # guards the following fields; never held during an SDK call
        self._session: Session | None = session
        self._seen: Seen | None = None
        self._last: tuple[int, int] | None = None  # number and time of the newest pair of this session
        self._over = False
        self._clock = DeviceClock()
        self._counts = {"dropped_frames": 0, "broken_frames": 0, "reconnects": 0}
        self._rate = Rate()
        self._temperatures_c: dict[str, float] = {}
        self.trouble = ""
        """The problem of the newest frame, or the reason why none comes; "" while frames are good."""
        self._said: tuple[str, float] = ("", -math.inf)
        self._thread = OwnedThread(Role.CAMERA_READ, self._run).start()

    # --- for other threads --------------------------------------------------------------------------------------------

    def is_alive(self) -> bool:
        """Whether the thread runs; False after `end` and after a defect."""
        return not self._over

    def exposed_after(self, asked_ns: int, patience_s: float) -> Seen | None:
        """Wait for a pair that was exposed, and arrived, after ``asked_ns`` of the monotonic clock.

        Args:
            patience_s: longest wait.

        Returns:
            The newest such pair; None when none came in time or the thread ended.
        """
        with self._news:
            self._news.wait_for(lambda: self._is_after(asked_ns) or self._over, patience_s)
            return self._seen if self._is_after(asked_ns) else None

    def refuse(self, seen: Seen, why: str) -> None:
        """Count and drop a pair that turned out to be unusable."""
        with self._news:
            self._counts["broken_frames"] += 1
            self.trouble = why
            if self._seen is seen:
                self._seen = None

    def readings(self) -> dict[str, float]:
        """Return temperatures, usable frames per second, counts, and clock error; empty while the camera is lost."""
        with self._news:
            if self._session is None and not self._over:
                return {}
            counts = {name: float(count) for name, count in self._counts.items()}
            known = {"clock_jumps": float(self._clock.jumps), "stamp_error_ms": self._clock.error_ns / 1e6}
            rate_hz = 0.0 if self._over else self._rate.hz(time.monotonic())
            return {"frames_per_s": rate_hz, **counts, **known, **self._temperatures_c}

    def end(self) -> None:
        """End the thread; one that hangs in the SDK for more than 5 s is abandoned and ends when the SDK returns."""
        self._ending.set()
        self._thread.join(_END_S)
        if self._thread.is_alive():
            _log.error("the camera's SDK does not come back; it is left behind")

    def _is_after(self, asked_ns: int) -> bool:
        seen = self._seen
        is_new = seen is not None and seen.pair.heard_ns >= asked_ns
        return is_new and seen is not None and seen.exposed_ns >= asked_ns + self._clock.error_ns

    # --- the reading thread -------------------------------------------------------------------------------------------

    def _run(self) -> None:
        """Read until `end`, and reopen whenever a session gave no usable frame for too long."""
        session: Session | None = self._session
        try:
            while not self._ending.is_set():
                reading, session = session, None
                if reading is not None:
                    self._read_all(reading)
                if not self._ending.is_set():
                    session = self._reopened()
        finally:
            with self._news:
                self._over = True
                self._news.notify_all()
            if session is not None:
                session.close()

    def _read_all(self, session: Session) -> None:
        """Read one session to its end, then close it."""
        try:
            self._read_from(session)
        finally:
            with self._news:
                self._session = self._seen = None
                self._clock.forget()
            session.close()

    def _read_from(self, session: Session) -> None:
        """Read until `end`, or until the camera is silent or gives only unusable frames for too long."""
        settled = Settled(self._settings.settle_frames)
        patience = _Patience(self._settings.lost_after_s)
        felt_s = -math.inf
        while not self._ending.is_set() and not patience.is_over():
            try:
                pair = session.next(_READ_S)
                if pair is None:
                    continue
                patience.hear(is_whole=True, is_used=self._hear(session, pair, settled))
                if time.monotonic() - felt_s > _FEEL_S:  # a silent camera would block for seconds
                    self._temperatures_c, felt_s = session.temperatures_c(), time.monotonic()
            except session.faults as error:
                self._say(" ".join(str(error).split()))
                return
            except UNREADABLE as error:
                patience.hear(is_whole=False, is_used=False)
                self._count_broken(" ".join(str(error).split()))
        if not self._ending.is_set():
            self._say(f"{patience.is_over()}; connecting anew")

    def _hear(self, session: Session, pair: Pair, settled: Settled) -> bool:
        """Take one pair and return whether it is usable. Raises: TornFrame, and the SDK's errors."""
        _require_whole(pair, session)
        with self._news:
            self._count(pair)
            off_us = (pair.arrived_ns - pair.heard_ns) // 1000  # from the monotonic clock to UTC
            fits = self._clock.hear(pair.device_us, pair.global_us - off_us if pair.global_us else 0, pair.heard_ns)
        if not fits:
            _log.warning("the camera's clock jumped; learning it anew")
            session.fit_clock()
        was_settled, is_settled = settled.is_done, settled.after(len(pair.jpeg))
        if is_settled and not was_settled and self._settings.fixed_exposure:
            session.fix_exposure()
        if not (is_settled and self._clock.is_known):
            return False
        exposed_ns = self._clock.host_ns(pair.device_us) + _HALF_EXPOSURE_NS
        with self._news:
            self._seen = Seen(pair, session, exposed_ns, exposed_ns + pair.arrived_ns - pair.heard_ns)
            self.trouble = ""
            self._news.notify_all()
        return True

    def _count(self, pair: Pair) -> None:
        """Count the pair. Raises: TornFrame for a repeated one."""
        last = self._last
        if last is not None and (pair.number, pair.device_us) == last:
            raise TornFrame("the camera repeats a frame")
        self._last = pair.number, pair.device_us
        self._counts["dropped_frames"] += max(0, pair.number - last[0] - 1) if last is not None else 0
        self._rate.count(time.monotonic())

    def _count_broken(self, why: str) -> None:
        with self._news:
            self._counts["broken_frames"] += 1
        self._say(why)

    def _say(self, trouble: str) -> None:
        """Log the trouble; the same text at most every 10 s."""
        self.trouble, now_s = trouble, time.monotonic()
        if trouble != self._said[0] or now_s - self._said[1] > _SAY_S:
            self._said = trouble, now_s
            _log.warning("camera: %s", trouble)

    def _reopened(self) -> Session | None:
        self._ending.wait(_AGAIN_S)
        try:
            session = self._reopen()
        except DriverUnavailable as error:
            self._say(str(error))
            return None
        with self._news:
            self._session, self._last = session, None
            self._counts["reconnects"] += 1
        return session


class _Patience:
    """Decides when a session is given up: `lost_after_s` of silence, a run of torn frames, or `READY_S` without use."""

    def __init__(self, lost_after_s: float) -> None:
        self._lost_after_s = lost_after_s
        self._heard_s = self._used_s = time.monotonic()
        self._torn = 0

    def hear(self, *, is_whole: bool, is_used: bool) -> None:
        """Note that a frame came."""
        self._heard_s = time.monotonic()
        self._torn = 0 if is_whole else self._torn + 1
        if is_used:
            self._used_s = self._heard_s

    def is_over(self) -> str:
        """Return the reason to give up, or "" while there is none."""
        now_s = time.monotonic()
        if now_s - self._heard_s > self._lost_after_s:
            return "the camera is silent"
        if self._torn >= _TORN_RUN:
            return "the camera gives only frames that cannot be used"
        return f"no frame could be used for {READY_S:.0f} s" if now_s - self._used_s > READY_S else ""


def _require_whole(pair: Pair, session: Session) -> None:
    """Raises: TornFrame for a pair without a time or an end, or of another size than the session's calibration.

    TypeError for one without a number, which must not be compared with the next one's.
    """
    operator.index(pair.number)
    lens, shape = session.depth_camera, np.shape(pair.depth_mm)
    if shape != (lens.height, lens.width) or pair.depth_mm.dtype != np.uint16:
        raise TornFrame(f"a depth image of {shape} {np.asarray(pair.depth_mm).dtype}")
    if not (math.isfinite(pair.scale_mm) and pair.scale_mm > 0):
        raise TornFrame(f"a depth image in units of {pair.scale_mm} mm")
    if pair.device_us <= 0:
        raise TornFrame("a frame without a time")
    # a decoder would fill the rest of a torn picture with grey
    if not (pair.jpeg[:2] == b"\xff\xd8" and pair.jpeg.rstrip(b"\0")[-2:] == b"\xff\xd9"):
        raise TornFrame("a torn picture")
