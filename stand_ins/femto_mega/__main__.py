"""``python -m stand_ins.femto_mega [HOST]``: serves until stdin ends; each line of stdin injects a fault.

``freeze``, ``thaw``, ``die``, ``live``, ``truncate N``, ``drop N``, ``jump MICROSECONDS``.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from typing import NoReturn

from stand_ins.femto_mega import scenery
from stand_ins.femto_mega.device import Device, Exposure
from stand_ins.femto_mega.servers import COLOR, CONTROL, DEPTH, Rtsp, Server, control


def serve(host: str, exposures: Iterator[Exposure]) -> None:
    """Serve what ``exposures`` gives, until stdin ends."""
    device = Device()
    depth = Rtsp(device, "OB_FMT_Y16", lambda pair: pair.depth, (640, 576))
    color = Rtsp(device, "OB_FMT_MJPEG", lambda pair: pair.jpeg, (1280, 720))
    servers = [
        Server(host, CONTROL, control(device)),
        Server(host, DEPTH, depth.serve),
        Server(host, COLOR, color.serve),
    ]
    threading.Thread(target=device.expose, args=(exposures,), daemon=True).start()
    print("serving", flush=True)  # noqa: T201
    for line in sys.stdin:
        _obey(device, servers, *line.split())


def serve_and_end(host: str, exposures: Iterator[Exposure]) -> NoReturn:
    """Serve as `serve` does, then end the process at once: what still draws would leave a traceback behind."""
    serve(host, exposures)
    os._exit(0)


def _obey(device: Device, servers: list[Server], fault: str, amount: str = "0") -> None:
    if fault in ("freeze", "thaw"):
        device.frozen = fault == "freeze"
    elif fault == "truncate":
        device.truncate = int(amount)
    elif fault == "drop":
        device.drop = int(amount)
    elif fault == "jump":
        device.clock_offset_us += int(amount)
    for server in servers:
        if fault == "die":
            server.die()
        elif fault == "live":
            server.live()
    print("done", flush=True)  # noqa: T201


if __name__ == "__main__":
    serve_and_end(sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1", scenery.still())
