"""Publishes the poses of all links of the arm, for 3-D viewers of the live cell and of recordings.

Frames: docs/frames.md.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from bus import topics
from bus.arrays import Joints
from bus.codec import decode
from bus.errors import BadPayload, BusError
from bus.messages import HandState
from bus.sample import Sample
from bus.sensor_codec import arm_q_rad, arm_stamp_ns, transforms_to_wire
from bus.session import Bus
from bus.threads import OwnedThread, Role
from planning.links import Links
from planning.robot import Robot

_PERIOD_S = 1 / 30
_AT_REST_S = 1.0
"""Period for an arm at rest: a new viewer or recording gets its pose within this time."""
_STILL_RAD, _STILL_M = 1e-4, 1e-4


class RobotTf:
    """A thread from construction to `close`: publishes the newest states of arm and hand as transforms at 30 Hz.

    An arm at rest is published once a second. Undecodable states are skipped; `cell.nodes.health` reports them.

    Args:
        is_ours: True for a sample of one of the cell's own nodes (`cell.nodes.speakers`).
    """

    def __init__(self, bus: Bus, robot: Robot, is_ours: Callable[[Sample], bool]) -> None:
        self._bus, self._links, self._is_ours = bus, Links(robot), is_ours
        self._arm = self._hand = b""  # replaced as a whole, on the bus's threads
        self._said: tuple[Joints, float] | None = None
        self._published_s = 0.0
        self._closing = threading.Event()
        self._thread = OwnedThread(Role.ROBOT_TF, self._run).start()
        bus.subscribe(topics.ARM_STATE.key, self._hear_arm)
        bus.subscribe(topics.HAND_STATE.key, self._hear_hand)

    def close(self) -> None:
        """End the thread; idempotent."""
        self._closing.set()
        self._thread.join()

    def _hear_arm(self, sample: Sample) -> None:
        if self._is_ours(sample):
            self._arm = sample.payload

    def _hear_hand(self, sample: Sample) -> None:
        if self._is_ours(sample):
            self._hand = sample.payload

    def _run(self) -> None:
        arm = b""
        while not self._closing.wait(_PERIOD_S):
            if self._arm is not arm:
                arm = self._arm
                try:
                    self._publish(arm, self._hand)
                except BadPayload:
                    continue
                except BusError:  # the session was closed
                    return

    def _publish(self, arm: bytes, hand: bytes) -> None:
        """Publish the transforms of two states. Raises: BadPayload for undecodable states, BusError."""
        q_rad, width_m = arm_q_rad(arm), decode(HandState, hand).width_m if hand else 0.0
        if not np.isfinite(width_m):
            raise BadPayload("A hand's width is no number.")
        if self._is_still(q_rad, width_m):
            return
        self._said, self._published_s = (q_rad, width_m), time.monotonic()
        placed = transforms_to_wire(self._links.at(q_rad, width_m), arm_stamp_ns(arm))
        self._bus.publish(topics.TF, placed.SerializeToString())

    def _is_still(self, q_rad: Joints, width_m: float) -> bool:
        if self._said is None or time.monotonic() - self._published_s >= _AT_REST_S:
            return False
        said_q_rad, said_m = self._said
        return bool(np.abs(q_rad - said_q_rad).max() < _STILL_RAD and abs(width_m - said_m) < _STILL_M)
