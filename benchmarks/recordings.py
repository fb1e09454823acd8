"""The cost of recording an RGB-D camera, compared with other MCAP writers for the same payloads."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Schema

from benchmarks.started import recorded_cycle
from benchmarks.writers import Batch, LoggedMessage, batches_of, compare
from bus import topics
from bus.codec import schema_of
from bus.messages import ArmMode, ArmState
from bus.sample import Sample
from bus.sensor_codec import arm_state_to_wire, frame_to_wire
from bus.topics import encoding_of
from cell.pick.record import CycleLog
from config.load import load_station
from drivers.node.registry import open_devices
from logs.mcap.recorder import Recorder

CAMERA_HZ, JOINTS_HZ = 30, 100
_PATIENCE_S = 30.0
_FRAMES = 6  # different noise in each
_FAST_FRAMES = 200
_COMPARED_FRAMES = 60


def run(seconds: float, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """Paced, then as fast as it goes; then each writer on a simulated cycle and on the camera's frames alone.

    CPU shares are of one core, of the whole process, less what the same loop takes that gives the payloads to nobody.
    """
    frames = _frames()
    traffic = list(_traffic(frames, seconds))
    with TemporaryDirectory() as name:
        folder = Path(name)
        loop_s = _paced(traffic, lambda _: None)
        tell(f"the loop alone: {loop_s / seconds:.3f} of a core")
        cpu_s = _recorded(folder / "paced.mcap", traffic) - loop_s
        tell(f"recording: {cpu_s / seconds:.3f} of a core")
        kept = _messages(folder / "paced.mcap")
        mb_s = _fast(folder / "fast.mcap", traffic)
        tell(f"fast: {mb_s:.0f} MB/s")
        cycle = recorded_cycle(folder / "cell", endpoint)
        figures = {
            "mb_s": round(mb_s, 1),
            "cpu_share_at_30hz": round(cpu_s / seconds, 4),
            "dropped": len(traffic) - kept,
            "payload_mb": round(sum(len(heard.payload) for _, heard in traffic) / 1e6, 1),
            "bytes_per_cycle": cycle.stat().st_size,
        }
        compared = {"cycle": batches_of(cycle), "camera": _camera_batches(frames)}
    return {**figures, "writers": compare(compared, tell)}


def _frames() -> list[list[Sample]]:
    """Frames of the simulated camera, as they travel."""
    devices = open_devices("sim", load_station())
    assert devices.camera is not None, "the simulation serves all devices"
    devices.camera.connect()
    frames = [frame_to_wire(devices.camera.capture()) for _ in range(_FRAMES)]
    devices.camera.close()
    return [[Sample(t.key, encoding_of(t.says), parts[t.key]) for t in topics.FRAME_PARTS] for parts in frames]


def _traffic(frames: list[list[Sample]], seconds: float) -> Iterator[tuple[float, Sample]]:
    """(when [s], payload), in order of time."""
    rng = np.random.default_rng(0)
    as_joints = encoding_of(topics.ARM_STATE.says)
    shown = itertools.cycle(frames)
    ticks = round(seconds * CAMERA_HZ * JOINTS_HZ)
    for tick in range(ticks):
        if tick % JOINTS_HZ == 0:
            for part in next(shown):
                yield tick / CAMERA_HZ / JOINTS_HZ, part
        if tick % CAMERA_HZ == 0:
            q, dq, tau = rng.normal(size=(3, 7))
            state = ArmState(stamp_ns=tick, mode=ArmMode.MOVE, q_rad=q, dq_rad_s=dq, tau_ext_nm=tau)
            yield tick / CAMERA_HZ / JOINTS_HZ, Sample(topics.ARM_STATE.key, as_joints, arm_state_to_wire(state))


def _camera_batches(frames: list[list[Sample]]) -> list[Batch]:
    """The frames alone, as many between two flushes as come in 100 ms."""
    shown = itertools.islice(itertools.cycle(frames), _COMPARED_FRAMES)
    logged = [_logged(number, part) for number, parts in enumerate(shown, 1) for part in parts]
    at_once = CAMERA_HZ // 10 * len(topics.FRAME_PARTS)
    return [logged[start : start + at_once] for start in range(0, len(logged), at_once)]


def _logged(number: int, part: Sample) -> LoggedMessage:
    schema = schema_of(part.encoding)
    return LoggedMessage(
        Schema(id=1, name=schema.name, encoding=schema.encoding, data=schema.data),
        Channel(id=1, topic=f"/{part.key}", message_encoding="protobuf", schema_id=1, metadata={}),
        number,
        part.payload,
    )


def _log(path: Path) -> CycleLog:
    def open_recorder() -> Recorder:
        recorder = Recorder(path, metadata={"cycle_id": path.stem}, clock=time.time_ns)
        recorder.attach("station.json", "application/json", b"{}")
        return recorder

    return CycleLog(open_recorder, path, _PATIENCE_S)


def _paced(traffic: list[tuple[float, Sample]], hear: Callable[[Sample], None]) -> float:
    """CPU time [s] of giving every payload to ``hear`` when it is due."""
    cpu_s, began_s = time.process_time(), time.monotonic()
    for at_s, heard in traffic:
        time.sleep(max(0.0, began_s + at_s - time.monotonic()))
        hear(heard)
    return time.process_time() - cpu_s


def _recorded(path: Path, traffic: list[tuple[float, Sample]]) -> float:
    """CPU time [s], this loop included."""
    cpu_s, log = time.process_time(), _log(path)
    _paced(traffic, log.hear)
    log.close({"result": "SUCCESS"})
    return time.process_time() - cpu_s


def _fast(path: Path, traffic: list[tuple[float, Sample]]) -> float:
    """MB/s from the first payload to the closed file."""
    some = [heard for _, heard in traffic if heard.key.startswith("camera/")][: _FAST_FRAMES * len(topics.FRAME_PARTS)]
    log = _log(path)
    began_s = time.monotonic()
    for heard in some:
        log.hear(heard)
    log.close({"result": "SUCCESS"})
    return sum(len(heard.payload) for heard in some) / 1e6 / (time.monotonic() - began_s)


def _messages(path: Path) -> int:
    """By the plain reader, checksums looked at."""
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False))
