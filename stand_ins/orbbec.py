"""Sessions with a Femto Mega, as its reader uses them: small images at any rate, with injectable faults."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from bus.errors import DriverUnavailable
from bus.messages import CameraModel
from config.hardware import FemtoMegaSettings
from drivers.femto_mega.session import Pair

LENS = CameraModel(width=8, height=6, fx=5.0, fy=5.0, cx=4.0, cy=3.0)
JPEG = cv2.imencode(".jpg", np.full((6, 8, 3), 90, np.uint8))[1].tobytes()
PERIOD_S = 0.002


class FakeOrbbec:
    """One camera; every session with it is made by `open`.

    Attributes:
        odd: what comes next instead of a good pair: a changed one, what is raised, or None.
        always: the same for every frame from now on. ``refusing``: why it cannot be connected to.
        goes_on: while not set, the SDK does not come back. ``utc_step_ns``: how far the wall clock was set.
        fixing: what is raised when its exposure is to be fixed.
    """

    def __init__(self) -> None:
        self.odd: deque[Callable[[Pair], Pair | None]] = deque()
        self.always: Callable[[Pair], Pair | None] | None = None
        self.refusing: DriverUnavailable | None = None
        self.fixing: Exception | None = None
        self.utc_step_ns = 0
        self.number = self.sessions = self.closed = 0
        self.goes_on = threading.Event()
        self.goes_on.set()

    def open(self, _settings: FemtoMegaSettings) -> Any:
        if self.refusing is not None:
            raise self.refusing
        self.sessions += 1
        return _Session(self)

    def utc_ns(self) -> int:
        return time.time_ns() + self.utc_step_ns


class _Session:
    faults = (RuntimeError,)
    color_camera = depth_camera = LENS
    color_from_depth = np.eye(4)

    def __init__(self, camera: FakeOrbbec) -> None:
        self._camera = camera

    def next(self, _patience_s: float) -> Pair | None:
        camera = self._camera
        assert camera.goes_on.wait(20)
        time.sleep(PERIOD_S)
        camera.number += 1
        utc_ns, begun_us = camera.utc_ns(), time.monotonic_ns() // 1000 - 10_000  # exposed for 10 ms
        pair = Pair(
            number=camera.number,
            device_us=begun_us + 7_000_000,
            global_us=utc_ns // 1000 - 10_000,
            arrived_ns=utc_ns,
            jpeg=JPEG,
            depth_mm=np.full((6, 8), 900, np.uint16),
            scale_mm=1.0,
        )
        if camera.odd:
            return camera.odd.popleft()(pair)
        return camera.always(pair) if camera.always is not None else pair

    def temperatures_c(self) -> dict[str, float]:
        return {}

    def fit_clock(self) -> None:
        pass

    def fix_exposure(self) -> None:
        if self._camera.fixing is not None:
            raise self._camera.fixing

    def close(self) -> None:
        self._camera.closed += 1
