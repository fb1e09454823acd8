"""A Femto Mega stand-in that shows the simulated table, with the arm at the pose of a running cell's arm.

``python -m stand_ins.mirror HOST ENDPOINT CELL_ID``
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from bus import topics
from bus.codec import decode
from bus.errors import BusError
from bus.messages import HandState
from bus.sample import Sample
from bus.session import Bus
from config.load import load_station
from drivers.sim.camera import SimCamera
from drivers.sim.world import World
from stand_ins.femto_mega.__main__ import serve_and_end
from stand_ins.femto_mega.device import Exposure

_PERIOD_S, _MOVING_PERIOD_S = 0.05, 0.2
_LONG_AGO_S = 0.4
_SAME_RAD = 1e-3


class Mirror:
    """The cell's arm and hand, as they were last heard."""

    def __init__(self) -> None:
        station = load_station()
        self.q_rad = np.array(station.arm.capture_q_rad)
        self.width_m = station.hand.max_width_m

    def hear_arm(self, heard: Sample) -> None:
        joints = JointStates.FromString(heard.payload).joints
        self.q_rad = np.array([joint.position for joint in joints])

    def hear_hand(self, heard: Sample) -> None:
        self.width_m = decode(HandState, heard.payload).width_m


def exposures(mirror: Mirror) -> Iterator[Exposure]:
    """The table, twenty times a second while the arm rests; drawing it takes a third of a second.

    While the arm moves, the last picture keeps the stream alive, stamped long enough ago that nobody who asks for a
    picture once the arm rests takes it for one.
    """
    world = World(load_station())
    camera = SimCamera(world)
    camera.connect()
    before_q_rad = drawn_q_rad = mirror.q_rad
    last = _drawn(world, camera, mirror, drawn_q_rad)
    while True:
        q_rad = mirror.q_rad
        before_q_rad, moved_rad = q_rad, np.abs(q_rad - before_q_rad).max()
        if moved_rad > _SAME_RAD:
            yield replace(last, taken_s=time.monotonic() - _LONG_AGO_S)
            time.sleep(_MOVING_PERIOD_S)
            continue
        if np.abs(q_rad - drawn_q_rad).max() > _SAME_RAD:
            last, drawn_q_rad = _drawn(world, camera, mirror, q_rad), q_rad
        taken_s = time.monotonic()  # nothing has moved since it was drawn
        if np.abs(mirror.q_rad - drawn_q_rad).max() <= _SAME_RAD:
            yield replace(last, taken_s=taken_s)
        time.sleep(_PERIOD_S)


def _drawn(world: World, camera: SimCamera, mirror: Mirror, q_rad: np.ndarray) -> Exposure:
    world.pose_robot(q_rad, mirror.width_m)
    frame = camera.capture()
    return Exposure(frame.color, np.nan_to_num(frame.depth_m * 1000).round().astype(np.uint16), 0.0)


def listen(mirror: Mirror, endpoint: str, cell_id: str) -> Bus:
    """Join the cell as soon as it is there."""
    while True:
        try:
            bus = Bus.join(cell_id, endpoint)
        except BusError:
            time.sleep(0.2)
            continue
        bus.subscribe(topics.ARM_STATE.key, mirror.hear_arm)
        bus.subscribe(topics.HAND_STATE.key, mirror.hear_hand)
        return bus


def main(host: str, endpoint: str, cell_id: str) -> NoReturn:
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text("10")  # drawing must not make the arm's commands late
    os.environ["LP_NUM_THREADS"] = "1"  # Mesa's software driver would take every core
    mirror = Mirror()
    threading.Thread(target=listen, args=(mirror, endpoint, cell_id), daemon=True).start()
    serve_and_end(host, exposures(mirror))


if __name__ == "__main__":
    main(*sys.argv[1:])
