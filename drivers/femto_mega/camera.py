"""The Femto Mega as a `Camera`: a thread reads, keeps the newest pair, and connects anew when the camera was lost."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from bus.errors import DriverUnavailable, NotConnected, StaleFrame
from bus.messages import Frame
from config.hardware import FemtoMegaSettings
from config.schema import Station
from drivers.femto_mega.clock import DeviceClock
from drivers.femto_mega.session import Pair, Session
from drivers.interface import Devices

_log = logging.getLogger(__name__)
_HALF_EXPOSURE_NS = 6_400_000
"""NFOV unbinned: nine pulses in 12.8 ms; the device stamps their beginning."""
_BEYOND_S = 0.1
"""How much longer a capture waits than it takes to find the camera lost."""
_READY_S = 10.0
_READ_S = 0.2
_AGAIN_S = 0.5
_FEEL_S = 5.0
_FULL_SCALE = 65535
_STEADY = 0.05
_STEADY_FRAMES = 5
_ADVICE = "Check the camera's cable, power and node; it is connected anew by itself."


@dataclass(frozen=True)
class _Seen:
    pair: Pair
    stamp_ns: int


class FemtoMega:
    """Depth 640x576 (NFOV unbinned) and colour 1280x720, both at 30 Hz and of one moment."""

    def __init__(self, settings: FemtoMegaSettings) -> None:
        self._settings = settings
        self._reader: threading.Thread | None = None
        self._ending = threading.Event()
        self._news = threading.Condition()  # guards what follows
        self._session: Session | None = None
        self._seen: _Seen | None = None
        self._clock = DeviceClock()
        self._counts = {"frames": 0, "dropped_frames": 0, "broken_frames": 0, "reconnects": 0}
        self._temperatures_c: dict[str, float] = {}
        self._started_s = 0.0

    # --- Camera -------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Open, let the exposure settle, learn the camera's clock. Raises: DriverUnavailable, with what to do."""
        if self._reader is not None:
            return
        self._ending.clear()
        self._session, self._started_s = self._open(), time.monotonic()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        with self._news:
            ready = self._news.wait_for(lambda: self._seen is not None, _READY_S)
        if not ready:
            self.close()
            raise DriverUnavailable(f"The camera gave no pictures within {_READY_S:.0f} s.", _ADVICE)

    def capture(self) -> Frame:
        """The next pair, exposed after this call; raises StaleFrame when none comes until it counts as lost."""
        asked_ns, patience_s = time.time_ns(), self._settings.lost_after_s + _BEYOND_S
        with self._news:
            self._require()
            fresh = self._news.wait_for(lambda: self._is_after(asked_ns), patience_s)
            session, seen = self._require(), self._seen
        if not fresh or session is None or seen is None:
            raise StaleFrame(f"The camera gave no new picture for {patience_s:.1f} s.", _ADVICE)
        return Frame(
            stamp_ns=seen.stamp_ns,
            color=_decoded(seen.pair.jpeg),
            depth_m=depth_m(seen.pair),
            color_camera=session.color_camera,
            depth_camera=session.depth_camera,
            color_from_depth=session.color_from_depth,
        )

    def close(self) -> None:
        self._ending.set()
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.join()

    def readings(self) -> dict[str, float]:
        """Temperatures, frame rate, counts, and how well its clock is known."""
        with self._news:
            if self._reader is None or self._session is None:
                return {}
            counts = {name: float(count) for name, count in self._counts.items()}
            rate = counts.pop("frames") / max(1e-3, time.monotonic() - self._started_s)
            known = {"clock_jumps": float(self._clock.jumps), "stamp_error_ms": self._clock.error_ns / 1e6}
            return {"frames_per_s": rate, **counts, **known, **self._temperatures_c}

    def _require(self) -> Session | None:
        """The session, None while the camera is lost."""
        if self._reader is None:
            raise NotConnected("The Femto Mega is not connected.", "Call connect() first.")
        return self._session

    def _is_after(self, asked_ns: int) -> bool:
        return self._seen is not None and self._seen.stamp_ns >= asked_ns + self._clock.error_ns

    # --- the reading thread -------------------------------------------------------------------------------------------

    def _open(self) -> Session:
        return Session(self._settings)

    def _read(self) -> None:
        """Until close: read, and open again whenever the camera was silent for too long."""
        session = self._session
        while not self._ending.is_set():
            if session is not None:
                self._read_from(session)
                with self._news:
                    self._session = self._seen = None
                    self._clock.forget()
                session.close()
            session = None if self._ending.is_set() else self._reopened()

    def _read_from(self, session: Session) -> None:
        """Until close, or the camera falls silent."""
        settled = _Settled(self._settings.settle_frames, self._fix(session))
        heard_s = time.monotonic()
        felt_s = -math.inf
        while not self._ending.is_set():
            try:
                pair = session.next(_READ_S)
                if pair is not None and time.monotonic() - felt_s > _FEEL_S:  # a silent camera would block for seconds
                    self._temperatures_c, felt_s = session.temperatures_c(), time.monotonic()
            except session.faults as error:
                _log.warning("camera: %s", error)
                return
            if pair is not None:
                heard_s = time.monotonic()
                self._hear(session, pair, settled)
            elif time.monotonic() - heard_s > self._settings.lost_after_s:
                _log.warning("the camera is silent; connecting anew")
                return

    def _hear(self, session: Session, pair: Pair, settled: _Settled) -> None:
        with self._news:
            whole = _is_whole(pair.jpeg)
            before = self._seen.pair.number if self._seen is not None else pair.number - 1
            self._counts["frames"] += 1
            self._counts["dropped_frames"] += max(0, pair.number - before - 1)
            self._counts["broken_frames"] += not whole
            if not self._clock.hear(pair.device_us, pair.global_us, pair.arrived_ns):
                _log.warning("the camera's clock jumped; learning it anew")
                session.fit_clock()
            if settled.after(pair) and whole and self._clock.is_known:
                self._seen = _Seen(pair, self._clock.utc_ns(pair.device_us) + _HALF_EXPOSURE_NS)
                self._news.notify_all()

    def _fix(self, session: Session) -> Callable[[], None]:
        return session.fix_exposure if self._settings.fixed_exposure else lambda: None

    def _reopened(self) -> Session | None:
        self._ending.wait(_AGAIN_S)
        try:
            session = self._open()
        except DriverUnavailable as error:
            _log.warning("camera: %s", error)
            return None
        with self._news:
            self._session = session
            self._counts["reconnects"] += 1
        return session


class _Settled:
    """Whether auto-exposure has come to rest: enough frames passed, and their size (so their content) is steady.

    A scene that never is steady counts as settled after three times as many frames.
    """

    def __init__(self, frames: int, then: Callable[[], None]) -> None:
        self._frames, self._then = frames, then
        self._sizes: list[int] = []
        self._done = False

    def after(self, pair: Pair) -> bool:
        if not self._done:
            self._sizes.append(len(pair.jpeg))
            last = self._sizes[-_STEADY_FRAMES:]
            steady = max(last) - min(last) <= _STEADY * max(last)
            enough = len(self._sizes) >= self._frames
            self._done = enough and (steady or len(self._sizes) >= 3 * self._frames)
            if self._done:
                self._then()
        return self._done


def depth_m(pair: Pair) -> np.ndarray:
    """(576, 640) float32 [m], NaN where the camera saw nothing."""
    metres = pair.depth_mm.astype(np.float32) * np.float32(pair.scale_mm / 1000.0)
    metres[(pair.depth_mm == 0) | (pair.depth_mm == _FULL_SCALE)] = np.nan
    return metres


def _decoded(jpeg: bytes) -> np.ndarray:
    color = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
    if color is None:
        raise StaleFrame("The newest picture does not decode.", "Capture again; if it stays so, check the cable.")
    return np.asarray(color)


def _is_whole(jpeg: bytes) -> bool:
    """A picture that ends where it should: a decoder would fill the rest of a torn one with grey."""
    return jpeg[:2] == b"\xff\xd8" and jpeg.rstrip(b"\0")[-2:] == b"\xff\xd9"


def open_devices(station: Station) -> Devices:
    """What the driver registry loads under the name ``femto_mega``."""
    return Devices(camera=FemtoMega(station.femto_mega))
