"""One connection to one camera: the only file that touches Orbbec's SDK.

The SDK crashes the process on a None where it expects an object, holds Python's lock while it connects, and returns a
dead device while any of its objects is still referenced. So no SDK object leaves this file, and `Session.close` drops
all of them.
"""

from __future__ import annotations

import functools
import gc
import importlib
import logging
import math
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bus.arrays import Transform
from bus.errors import DeviceAbsent, DriverUnavailable
from bus.messages import CameraModel
from bus.transforms import from_rotation
from config.hardware import FemtoMegaSettings

_log = logging.getLogger(__name__)
_PORT = 8090
_PROBE_S = 1.0
_ORBBEC, _FEMTO_MEGAS = 0x2BC5, (0x0669, 0x06C0)
_DEPTH, _COLOR = (640, 576, 30), (1280, 720, 30)
_QUEUED = 10
"""Number of pairs that the SDK queues."""
_CABLE = "Check its power, the gigabit cable and femto_mega.address; `cell doctor` looks for it."


UNREADABLE = (ValueError, TypeError, AttributeError, BufferError, OverflowError)
"""Errors of reading a malformed buffer, number or object of the SDK."""


class TornFrame(ValueError):
    """A frame that is unusable; the next one may be good."""


@dataclass(frozen=True)
class Pair:
    """Colour and depth of one exposure, copied out of the SDK.

    Attributes:
        number: the device's count of depth frames.
        device_us, global_us: start of the exposure by the camera's clock, and as UTC by the SDK's fit (0 = none yet).
        arrived_ns, heard_ns: time of arrival, in UTC and by the monotonic clock.
        jpeg: the colour picture.
        depth_mm: (576, 640) uint16, 0 = invalid. ``scale_mm``: of one unit of it.
    """

    number: int
    device_us: int
    global_us: int
    arrived_ns: int
    jpeg: bytes
    depth_mm: np.ndarray
    scale_mm: float
    heard_ns: int = field(default_factory=time.monotonic_ns)


class Session:
    """A camera that is opened and streaming.

    Args:
        open_device: replaces opening by address or serial number, given the SDK and its context (a playback, in tests).

    Attributes:
        faults: the SDK's exception types.
        depth_camera, color_camera: the lenses' calibration.
        color_from_depth: (4, 4) pose of the depth camera in the colour camera [m].

    Raises:
        DriverUnavailable: with what to do; nothing stays open.
    """

    def __init__(
        self,
        settings: FemtoMegaSettings,
        open_device: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        self._sdk, context = _sdk_and_context(settings.extensions)
        self._pipeline: Any = None
        self._device: Any = None
        self.faults = (self._sdk.OBError, RuntimeError)
        try:
            self._device = open_device(self._sdk, context) if open_device else _open(self._sdk, context, settings)
            self._start()
        except (*self.faults, *UNREADABLE) as error:
            self.close()
            raise DeviceAbsent(f"The Femto Mega cannot be used: {_said(error)}.", _CABLE) from error
        except DriverUnavailable:
            self.close()
            raise

    # --- streaming ----------------------------------------------------------------------------------------------------

    def _start(self) -> None:
        sdk = self._sdk
        self._pipeline = sdk.Pipeline(self._device)
        depth = self._profile(sdk.OBSensorType.DEPTH_SENSOR, _DEPTH, sdk.OBFormat.Y16)
        color = self._profile(sdk.OBSensorType.COLOR_SENSOR, _COLOR, sdk.OBFormat.MJPG)
        self.depth_camera, self.color_camera = _camera_model(depth), _camera_model(color)
        self.color_from_depth = _pose(depth.get_extrinsic_to(color))
        config = sdk.Config()
        config.enable_stream(depth)
        config.enable_stream(color)
        config.set_frame_aggregate_output_mode(sdk.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        self._pipeline.enable_frame_sync()
        self._pipeline.start(config)
        self.fit_clock()

    def _profile(self, sensor: Any, wanted: tuple[int, int, int], encoding: Any) -> Any:
        width, height, fps = wanted
        profiles = self._pipeline.get_stream_profile_list(sensor)
        try:
            return profiles.get_video_stream_profile(width, height, encoding, fps)
        except self.faults as error:
            count = profiles.get_count() if hasattr(profiles, "get_count") else len(profiles)
            there = [profiles.get_stream_profile_by_index(index).as_video_stream_profile() for index in range(count)]
            listed = ", ".join(sorted({f"{p.get_width()}x{p.get_height()}@{p.get_fps()}" for p in there}))
            raise DriverUnavailable(
                f"The camera has no {width}x{height}@{fps} {encoding.name}; it has {listed}.", "Update its firmware."
            ) from error

    def next(self, patience_s: float) -> Pair | None:
        """Return the newest pair; older ones in the queue are dropped.

        Args:
            patience_s: longest wait.

        Returns:
            None when none came in time.

        Raises:
            TornFrame: the pair is unusable.
            Exception: one of `faults`, when the connection is unusable.
        """
        frames = self._pipeline.wait_for_frames(int(patience_s * 1000))
        for _ in range(_QUEUED):
            newer = self._pipeline.wait_for_frames(1) if frames is not None else None
            if newer is None:
                break
            frames = newer
        return None if frames is None else pair_of(frames)

    def fit_clock(self) -> None:
        """Start the SDK's fit of the camera's clock to the host's; a playback has no clock."""
        with suppress(*self.faults):
            self._device.enable_global_timestamp(False)
            self._device.enable_global_timestamp(True)

    def fix_exposure(self) -> None:
        """Keep the exposure that auto-exposure found."""
        automatic = self._sdk.OBPropertyID.OB_PROP_COLOR_AUTO_EXPOSURE_BOOL
        if self._device.is_property_supported(automatic, self._sdk.OBPermissionType.PERMISSION_WRITE):
            self._device.set_bool_property(automatic, False)

    def temperatures_c(self) -> dict[str, float]:
        """Return temperatures by name, e.g. ``ir_temperature_c``; empty when the camera does not answer."""
        try:
            felt = self._device.get_temperature()
            named = {"cpu": felt.cpu_temperature, "ir": felt.ir_temperature, "laser": felt.laser_temperature}
            return {f"{name}_temperature_c": float(value) for name, value in named.items()}
        except (*self.faults, *UNREADABLE) as error:
            _log.warning("the camera's temperature cannot be read: %s", _said(error))
            return {}

    def close(self) -> None:
        """Stop the stream and drop every SDK reference; idempotent."""
        pipeline, self._pipeline, self._device = self._pipeline, None, None
        if pipeline is not None:
            with suppress(*self.faults):
                pipeline.stop()
        del pipeline
        gc.collect()


def pair_of(frames: Any) -> Pair | None:
    """Copy a frame set out of the SDK; None when it lacks colour or depth. Raises: TornFrame when it is malformed."""
    depth, color = frames.get_depth_frame(), frames.get_color_frame()
    if depth is None or color is None:
        return None
    try:
        height, width = depth.get_height(), depth.get_width()
        return Pair(
            number=int(depth.get_index()),
            device_us=int(depth.get_timestamp_us()),
            global_us=_utc_us(int(depth.get_global_timestamp_us())),
            arrived_ns=time.time_ns(),
            jpeg=np.asarray(color.get_data()).tobytes(),
            depth_mm=np.frombuffer(np.asarray(depth.get_data()).tobytes(), "<u2").reshape(height, width),
            scale_mm=float(depth.get_depth_scale()),
        )
    except UNREADABLE as error:
        raise TornFrame(f"a frame cannot be read: {_said(error)}") from error


def _utc_us(global_us: int) -> int:
    """Convert the SDK's time (see `_sdk_and_context`) to UTC; 0 = not known yet."""
    if global_us <= 0:
        return 0
    return global_us + (time.time_ns() - time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)) // 1000


# --- opening ----------------------------------------------------------------------------------------------------------


@functools.cache
def _sdk_and_context(extensions: Path | None) -> tuple[Any, Any]:
    """Return the SDK and its one context, kept as long as the process lives. Raises: DriverUnavailable."""
    try:
        sdk = importlib.import_module("pyorbbecsdk")
    except ImportError as error:
        raise DriverUnavailable(
            f"pyorbbecsdk cannot be imported: {error}.",
            "uv pip install 'vlad-cell[femto]'; it has wheels for Python up to 3.13.",
        ) from error
    sdk.Context.set_logger_to_file(sdk.OBLogLevel.NONE, "")  # else ./Log grows to 300 MB
    sdk.Context.set_logger_to_console(sdk.OBLogLevel.NONE)
    if extensions is not None:
        sdk.Context.set_extensions_directory(str(extensions))
    context = sdk.Context()
    # fit the camera's clock to CLOCK_MONOTONIC_RAW, which cannot be set (the alternative is UTC)
    context.set_timestamp_clock_type(sdk.OBClockType.MONOTONIC)
    return sdk, context


def _open(sdk: Any, context: Any, settings: FemtoMegaSettings) -> Any:
    if settings.address is not None:
        _probe(settings.address)
        context.enable_net_device_enumeration(False)
        device = context.create_net_device(settings.address, _PORT)
    elif settings.serial is not None:
        device = context.query_devices().get_device_by_serial_number(settings.serial)
    else:
        raise DriverUnavailable("Which camera is not said.", "Set femto_mega.address or femto_mega.serial.")
    info = device.get_device_info()
    if (info.get_vid(), info.get_pid()) not in [(_ORBBEC, product) for product in _FEMTO_MEGAS]:
        raise DriverUnavailable(f"{info.get_name()} is no Femto Mega.", "Correct femto_mega.address.")
    if settings.serial is not None and info.get_serial_number() != settings.serial:
        raise DriverUnavailable(
            f"At {settings.address} is the camera {info.get_serial_number()}, not {settings.serial}.",
            "Correct femto_mega.address or femto_mega.serial; another camera needs a calibration of its own.",
        )
    return device


def _probe(address: str) -> None:
    """Check that the camera answers, because the SDK would wait 26 s for it and hold Python's lock meanwhile."""
    try:
        socket.create_connection((address, _PORT), _PROBE_S).close()
    except OSError as error:
        raise DeviceAbsent(f"No camera answers at {address}: {error}.", _CABLE) from error


def _camera_model(profile: Any) -> CameraModel:
    lens, bent = profile.get_intrinsic(), profile.get_distortion()
    distortion = (bent.k1, bent.k2, bent.p1, bent.p2, bent.k3, bent.k4, bent.k5, bent.k6)
    is_finite = all(map(math.isfinite, (lens.fx, lens.fy, lens.cx, lens.cy, *distortion)))
    if not (is_finite and lens.fx > 0 and lens.fy > 0):
        raise ValueError("its calibration has no usable focal length or distortion")
    return CameraModel(
        width=lens.width, height=lens.height, fx=lens.fx, fy=lens.fy, cx=lens.cx, cy=lens.cy, distortion=distortion
    )


def _pose(extrinsic: Any) -> Transform:
    """Return ``color_from_depth``, with the device's single-precision matrix projected onto an exact rotation."""
    u, _, vt = np.linalg.svd(np.asarray(extrinsic.rot, dtype=float).reshape(3, 3))
    return from_rotation(u @ vt, np.asarray(extrinsic.transform, dtype=float).ravel() / 1000.0)


def _said(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".")
