"""The simulated Panda hand: moves at a speed, grasps with a force, measures its width."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from bus.errors import HandFault, NotConnected
from bus.messages import HandState
from drivers.motion.stops import Stops
from drivers.sim.fingers import Fingers
from drivers.sim.world import World

_MOVE_FORCE_N = 20.0


class SimHand:
    """Two coupled fingers; speeds are the rate of the width, both fingers together (docs/frames.md)."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._connected = False
        self._homed = False
        self._moving = False
        self._acting = threading.Lock()
        self._stops = Stops()

    def connect(self) -> None:
        """Mark as connected."""
        self._connected = True

    def close(self) -> None:
        """Stop and mark as not connected; idempotent."""
        self.stop()
        self._connected = False

    def state(self) -> HandState:
        """Return the measured state. Raises: NotConnected."""
        self._require()
        return HandState(
            stamp_ns=self._world.clock_ns(),
            width_m=max(0.0, self._world.hand_width_m()),
            is_moving=self._moving,
            is_homed=self._homed,
            clock_s=self._world.time_s(),
        )

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Move to ``width_m`` at ``speed_m_s``; return when the fingers rest. Raises: HandFault, NotConnected."""
        self._require()
        widest_m = self._world.station.hand.max_width_m
        if not (math.isfinite(width_m) and 0 <= width_m <= widest_m):
            raise HandFault(f"The hand cannot open to {width_m} m.", f"Ask for 0 to {widest_m} m.")
        self._drive(width_m, speed_m_s, _MOVE_FORCE_N, self._stops.asked())
        return self.state()

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Close at ``speed_m_s`` and press with ``force_n``; return when the fingers rest. Raises: as `move`."""
        self._require()
        if not (math.isfinite(force_n) and force_n > 0):
            raise HandFault(f"The hand cannot grasp with {force_n} N.", "Ask for a positive force.")
        self._drive(None, speed_m_s, force_n, self._stops.asked())
        return self.state()

    def home(self) -> HandState:
        """Close and open once; a stopped homing does not count. Raises: NotConnected."""
        self._require()
        hand = self._world.station.hand
        stopped = self._stops.asked()
        for width_m in (0.0, hand.max_width_m):
            self._drive(width_m, hand.max_speed_m_s, _MOVE_FORCE_N, stopped)
        self._homed = self._homed or not stopped()
        return self.state()

    def stop(self) -> None:
        """Stop the fingers where they are; a grasp keeps its force."""
        self._stops.stop()

    def _drive(self, to_m: float | None, speed_m_s: float, force_n: float, stopped: Callable[[], bool]) -> None:
        """Move the fingers until they rest there, or, with None, on an object; one motion at a time."""
        if not (math.isfinite(speed_m_s) and speed_m_s > 0):
            raise HandFault(f"The hand cannot move at {speed_m_s} m/s.", "Ask for a positive speed.")
        speed_m_s = min(speed_m_s, self._world.station.hand.max_speed_m_s)
        with self._acting:
            self._moving = True
            try:
                self._world.move_fingers(Fingers(self._world.hand_width_m(), to_m, speed_m_s, force_n, stopped))
            finally:
                self._moving = False

    def _require(self) -> None:
        if not self._connected:
            raise NotConnected("The simulated hand is not connected.", "Call connect() first.")
