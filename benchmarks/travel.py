"""Overhead of our bus over plain Zenoh: round trips of a camera frame (2.7 MB) and a command between two processes.

Both sides ask a second process for the same bytes: ours through `Bus.ask` and `Bus.answer` (typed errors, workers, the
recorder's tap), the plain one with ``get`` and a queryable that replies in its callback. They take turns, one query
each, over sessions with the same settings. Encoding and decoding of the frame are figures of their own.
"""

from __future__ import annotations

import gc
import random
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh

from bus import topics
from bus.codec import decode, encode
from bus.commands import CommandReply, CommandRequest, Nothing
from bus.messages import CameraModel, Frame
from bus.sample import Sample
from bus.secured import session_config
from bus.sensor_codec import frame_from_wire, frame_to_wire
from bus.session import Bus
from bus.topics import encoding_of

_CELL = "travel"
_FRAME, _COMMAND = "plain/frame", "plain/command"
_REQUEST = CommandRequest(command_id="0" * 32, client_id="benchmark")
_REPLY = CommandReply(ok=True, state="Execute", available=("stop", "hold", "abort"), cycle_id="20260101T000000000")
_TIMEOUT_S = 10.0
_WARM_UP = 20
_FRAME_BYTES = 2_700_000


def run(rounds: int, seed: int, endpoint: str, plain_endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """``rounds`` of every question, ours and plain Zenoh's in turn; times in ms, ratios of the medians."""
    frame = _frame(seed)
    with (
        Bus.listen(_CELL, endpoint) as bus,
        zenoh.open(session_config("peer", listen=[plain_endpoint], connect=[], file=None)) as plain,
        _other_process(str(seed), endpoint, plain_endpoint),
    ):
        bus.tap = lambda sample: None
        ask: dict[str, Callable[[], object]] = {
            "frame": lambda: bus.ask(topics.CAMERA_CAPTURE, Nothing(), timeout_s=_TIMEOUT_S),
            "plain_frame": lambda: _get(plain, _FRAME, b"{}"),
            "command": lambda: bus.request(topics.COMMAND, _REQUEST, CommandReply, timeout_s=_TIMEOUT_S, verb="reset"),
            "plain_command": lambda: _get(plain, _COMMAND, encode(_REQUEST)),
        }
        took_ms: dict[str, list[float]] = {}
        for names in (("frame", "plain_frame"), ("command", "plain_command")):  # what follows a frame pays for it
            took_ms |= _measure({name: ask[name] for name in names}, rounds)
    parts = frame_to_wire(frame)
    took_ms |= _measure({"encode": lambda: frame_to_wire(frame), "decode": lambda: frame_from_wire(parts)}, 20)
    figures = {name: _summary(times) for name, times in took_ms.items()}
    result: dict[str, Any] = {name: {"bus": figures[name], "plain": figures[f"plain_{name}"],
                     "ratio": round(figures[name]["median_ms"] / figures[f"plain_{name}"]["median_ms"], 2)}
              for name in ("frame", "command")}  # fmt: skip
    tell(
        f"a frame takes {result['frame']['ratio']} times as long as plain Zenoh, a command {result['command']['ratio']}"
    )
    return {
        **result,
        "frame_bytes": _FRAME_BYTES,
        "encode": figures["encode"],
        "decode": figures["decode"],
        "rounds": rounds,
    }


def _measure(ask: dict[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """One question of each, again and again, in an order drawn anew."""
    rng = random.Random(0)
    took_ms: dict[str, list[float]] = {name: [] for name in ask}
    gc.collect()
    for number in range(rounds + _WARM_UP):
        for name, question in rng.sample(list(ask.items()), len(ask)):
            started_s = time.perf_counter()
            question()
            if number >= _WARM_UP:
                took_ms[name].append((time.perf_counter() - started_s) * 1e3)
    return took_ms


def _summary(times_ms: list[float]) -> dict[str, float]:
    return {"median_ms": round(float(np.median(times_ms)), 3), "p99_ms": round(float(np.quantile(times_ms, 0.99)), 3)}


def _get(session: zenoh.Session, key: str, payload: bytes) -> list[bytes]:
    replies = list(session.get(key, payload=payload, timeout=_TIMEOUT_S))
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def _frame(seed: int) -> Frame:
    """Colour 1280 x 720 that compresses badly, depth 640 x 576; what travels is filled up to `_FRAME_BYTES`."""
    rng = np.random.default_rng(seed)
    color_camera = CameraModel(width=1280, height=720, fx=600.0, fy=600.0, cx=640.0, cy=360.0, distortion=(0.0,) * 8)
    depth_camera = CameraModel(width=640, height=576, fx=600.0, fy=600.0, cx=320.0, cy=288.0, distortion=(0.0,) * 8)
    return Frame(
        stamp_ns=1,
        color=rng.integers(0, 256, (720, 1280, 3), dtype=np.uint8),
        depth_m=np.round(rng.uniform(0.3, 1.5, (576, 640)), 3).astype(np.float32),
        color_camera=color_camera,
        depth_camera=depth_camera,
        color_from_depth=np.eye(4),
    )


# --- the other process ------------------------------------------------------------------------------------------------


@contextmanager
def _other_process(*arguments: str) -> Any:
    command = [sys.executable, "-m", "benchmarks.travel", *arguments]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    try:
        assert process.stdout.readline() == "ready\n"
        yield
    finally:
        process.stdin.close()
        process.wait(10)
        process.stdout.close()


def _serve(seed: str, endpoint: str, plain_endpoint: str) -> None:
    parts = frame_to_wire(_frame(int(seed)))
    parts[topics.CAMERA_COLOR.key] += bytes(_FRAME_BYTES - sum(len(part) for part in parts.values()))
    frame = [Sample(topic.key, encoding_of(topic.says), parts[topic.key]) for topic in topics.FRAME_PARTS]
    reply = encode(_REPLY)

    def command(payload: bytes, _fields: object) -> CommandReply:
        decode(CommandRequest, payload)
        return _REPLY

    def plain_frame(query: zenoh.Query) -> None:
        with query:
            for part in frame:
                query.reply(_FRAME, part.payload, encoding=part.encoding)

    def plain_command(query: zenoh.Query) -> None:
        with query:
            query.reply(_COMMAND, reply, encoding="application/json")

    with (
        Bus.join(_CELL, endpoint) as bus,
        zenoh.open(session_config("client", listen=[], connect=[plain_endpoint], file=None)) as plain,
    ):
        bus.answer(topics.CAMERA_CAPTURE, lambda _payload, _fields: frame, worker="camera")
        bus.answer(topics.COMMAND, command, worker="command", verb="*")
        plain.declare_queryable(_FRAME, plain_frame)
        plain.declare_queryable(_COMMAND, plain_command)
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    _serve(*sys.argv[1:])
