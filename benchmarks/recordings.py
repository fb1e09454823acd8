"""The cost of recording an RGB-D camera, compared with foxglove-sdk recording the same payloads."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import foxglove
import numpy as np
from mcap.reader import make_reader

from bus import topics
from bus.codec import schema_of
from bus.messages import ArmMode, ArmState
from bus.sample import Sample
from bus.topics import encoding_of
from bus.wire import arm_state_to_wire, frame_to_wire
from cell.pick.record import CycleLog
from config.load import load_station
from drivers.node.registry import open_devices
from logs.mcap.recorder import Recorder

CAMERA_HZ, JOINTS_HZ = 30, 100
_PATIENCE_S = 30.0
_FRAMES = 6  # different noise in each
_FAST_FRAMES = 200


def run(seconds: float, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """Paced, then as fast as it goes, then foxglove-sdk.

    CPU shares are of one core, of the whole process, less what the same loop takes that gives the payloads to nobody.
    """
    traffic = list(_traffic(_frames(), seconds))
    with TemporaryDirectory() as name:
        folder = Path(name)
        loop_s = _paced(traffic, lambda _: None)
        tell(f"the loop alone: {loop_s / seconds:.3f} of a core")
        cpu_s = _recorded(folder / "paced.mcap", traffic) - loop_s
        tell(f"recording: {cpu_s / seconds:.3f} of a core")
        ours_bytes, kept = (folder / "paced.mcap").stat().st_size, _messages(folder / "paced.mcap")
        mb_s = _fast(folder / "fast.mcap", traffic)
        tell(f"fast: {mb_s:.0f} MB/s")
        theirs_cpu_s = _foxglove(folder / "foxglove.mcap", traffic)
        theirs_bytes = (folder / "foxglove.mcap").stat().st_size
        tell(f"foxglove-sdk: {theirs_cpu_s / seconds:.3f} of a core, {theirs_bytes / 1e6:.1f} MB")
        cycle_bytes = _cycle_bytes(folder / "cell", endpoint)
    return {
        "mb_s": round(mb_s, 1),
        "cpu_share_at_30hz": round(cpu_s / seconds, 4),
        "dropped": len(traffic) - kept,
        "bytes_per_cycle": cycle_bytes,
        "ratio_to_foxglove_sdk": round(ours_bytes / theirs_bytes, 4),
        "cpu_share_foxglove_sdk": round(theirs_cpu_s / seconds, 4),
        "payload_mb": round(sum(len(heard.payload) for _, heard in traffic) / 1e6, 1),
    }


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


def _foxglove(path: Path, traffic: list[tuple[float, Sample]]) -> float:
    """CPU time [s] of foxglove-sdk's MCAP writer with its defaults."""
    context = foxglove.Context()
    channels = {}
    for _, heard in traffic:
        if heard.key not in channels:
            schema = schema_of(heard.encoding)
            channels[heard.key] = foxglove.Channel(
                f"/{heard.key}",
                schema=foxglove.Schema(name=schema.name, encoding=schema.encoding, data=schema.data),
                message_encoding="protobuf",
                context=context,
            )
    cpu_s = time.process_time()
    with foxglove.open_mcap(path, context=context):
        for at_s, heard in traffic:
            channels[heard.key].log(heard.payload, log_time=round(at_s * 1e9))
    return time.process_time() - cpu_s


def _messages(path: Path) -> int:
    """By the plain reader, checksums looked at."""
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False))


def _cycle_bytes(folder: Path, endpoint: str) -> int | None:
    """Size of one simulated cycle's recording; None when the cell ended before one was recorded."""
    settings = (f"recording.folder={folder}", f"bus.endpoint={endpoint}")
    command = [sys.executable, "-m", "cell", "start", "--cycles", "1", "--json"]
    done = subprocess.run(
        [*command, *(part for setting in settings for part in ("--set", setting))],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    )
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    recordings = [Path(line["recording"]) for line in lines if "recording" in line]
    return recordings[-1].stat().st_size if recordings else None
