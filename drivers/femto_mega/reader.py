"""The thread that reads a Femto Mega, keeps the newest pair, and connects anew when there is none to be used."""

from __future__ import annotations

import logging
import math
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
"""NFOV unbinned: nine pulses in 12.8 ms; the device stamps their beginning."""
READY_S = 10.0
"""By then the exposure has settled and the clock is known; without a usable frame for so long a camera is lost."""
_READ_S = 0.2
_AGAIN_S = 0.5
_FEEL_S = 5.0
_SAY_S = 10.0
_END_S = 5.0
_TORN_RUN = 30
"""So many frames in a row that cannot be used, a second of them, are no accident."""


@dataclass(frozen=True)
class Seen:
    """A pair that can be used.

    Attributes:
        session: whose calibration it has. ``exposed_ns``: middle of the exposure by the monotonic clock.
        stamp_ns: the same in UTC.
    """

    pair: Pair
    session: Session
    exposed_ns: int
    stamp_ns: int


class Reader:
    """Reads from ``session`` on, until ended.

    Args:
        reopen: opens another session. Raises: DriverUnavailable.
    """

    def __init__(self, session: Session, reopen: Callable[[], Session], settings: FemtoMegaSettings) -> None:
        self._reopen, self._settings = reopen, settings
        self._ending = threading.Event()
        self._news = threading.Condition()  # guards what follows; never held while the SDK is asked
        self._session: Session | None = session
        self._seen: Seen | None = None
        self._last: tuple[int, int] | None = None  # number and time of the newest pair of this session
        self._over = False
        self._clock = DeviceClock()
        self._counts = {"dropped_frames": 0, "broken_frames": 0, "reconnects": 0}
        self._rate = Rate()
        self._temperatures_c: dict[str, float] = {}
        self.trouble = ""
        """What was wrong with the newest frame, or kept one from coming; "" while they are good."""
        self._said: tuple[str, float] = ("", -math.inf)
        self._thread = OwnedThread(Role.CAMERA_READ, self._run).start()

    # --- for other threads --------------------------------------------------------------------------------------------

    def is_alive(self) -> bool:
        """False after `end`, and after an end that nobody foresaw."""
        return not self._over

    def exposed_after(self, asked_ns: int, patience_s: float) -> Seen | None:
        """The newest pair that was exposed, and came, after ``asked_ns`` by the monotonic clock; None: none in time."""
        with self._news:
            self._news.wait_for(lambda: self._is_after(asked_ns) or self._over, patience_s)
            return self._seen if self._is_after(asked_ns) else None

    def refuse(self, seen: Seen, why: str) -> None:
        """Count a pair that turned out to be of no use."""
        with self._news:
            self._counts["broken_frames"] += 1
            self.trouble = why
            if self._seen is seen:
                self._seen = None

    def readings(self) -> dict[str, float]:
        """Temperatures, usable frames a second lately, counts, how well the clock is known; empty while it is lost."""
        with self._news:
            if self._session is None and not self._over:
                return {}
            counts = {name: float(count) for name, count in self._counts.items()}
            known = {"clock_jumps": float(self._clock.jumps), "stamp_error_ms": self._clock.error_ns / 1e6}
            rate_hz = 0.0 if self._over else self._rate.hz(time.monotonic())
            return {"frames_per_s": rate_hz, **counts, **known, **self._temperatures_c}

    def end(self) -> None:
        """A thread that hangs in the SDK is left behind: it ends as soon as it comes back."""
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
        """Until the end: read, and open again whenever a session gave nothing to be used for too long."""
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
        """One session, to its end."""
        try:
            self._read_from(session)
        finally:
            with self._news:
                self._session = self._seen = None
                self._clock.forget()
            session.close()

    def _read_from(self, session: Session) -> None:
        """Until the end, or the camera is silent, torn or useless for too long."""
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
        """Take one pair; whether it can be used. Raises: TornFrame, and what the SDK raises."""
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
        """Raises: TornFrame for one that came before."""
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
        """Log it; not again for a while, however often it comes."""
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
    """When a session is given up: after ``lost_after_s`` of silence, a run of torn frames, or `READY_S` without use."""

    def __init__(self, lost_after_s: float) -> None:
        self._lost_after_s = lost_after_s
        self._heard_s = self._used_s = time.monotonic()
        self._torn = 0

    def hear(self, *, is_whole: bool, is_used: bool) -> None:
        """A frame came."""
        self._heard_s = time.monotonic()
        self._torn = 0 if is_whole else self._torn + 1
        if is_used:
            self._used_s = self._heard_s

    def is_over(self) -> str:
        """Why, or "" as long as it is not."""
        now_s = time.monotonic()
        if now_s - self._heard_s > self._lost_after_s:
            return "the camera is silent"
        if self._torn >= _TORN_RUN:
            return "the camera gives only frames that cannot be used"
        return f"no frame could be used for {READY_S:.0f} s" if now_s - self._used_s > READY_S else ""


def _require_whole(pair: Pair, session: Session) -> None:
    """Raises: TornFrame for a pair that is not what the session's calibration is of, or has no time, or no end."""
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
