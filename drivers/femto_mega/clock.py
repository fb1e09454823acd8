"""From the camera's clock to UTC, and how well that is known."""

from __future__ import annotations

from collections import deque

_KEPT = 60
_FEWEST = 10
_JUMP_US = 500_000
"""More than any delay on the way here varies by."""
_ROUND_TRIP_NS = 1_000_000
"""What half a round trip to the camera may hide in every sample."""


class DeviceClock:
    """Learns the offset between the camera's clock and UTC from the SDK's own fit, and notices when it jumps.

    Attributes:
        jumps: how often the camera's clock was set, since this was made.
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=_KEPT)
        self._last: tuple[int, int] | None = None
        self.jumps = 0

    def hear(self, device_us: int, global_us: int, arrived_ns: int) -> bool:
        """One frame's stamps: the camera's, the same as UTC by the SDK (0 = not known), and its arrival here.

        Returns: False when the camera's clock has jumped: what was learnt is forgotten.
        """
        last, self._last = self._last, (device_us, arrived_ns)
        if last is not None and abs((device_us - last[0]) - (arrived_ns - last[1]) // 1000) > _JUMP_US:
            self.jumps += 1
            self._offsets_ns.clear()
            return False
        if global_us > 0:
            self._offsets_ns.append((global_us - device_us) * 1000)
        return True

    def forget(self) -> None:
        """After a reconnection."""
        self._offsets_ns.clear()
        self._last = None

    @property
    def is_known(self) -> bool:
        return len(self._offsets_ns) >= _FEWEST

    @property
    def error_ns(self) -> int:
        """Half of what the offset wandered lately, and of a round trip."""
        return (max(self._offsets_ns) - min(self._offsets_ns)) // 2 + _ROUND_TRIP_NS if self._offsets_ns else 0

    def utc_ns(self, device_us: int) -> int:
        """UTC [ns] of a stamp of the camera; only when `is_known`."""
        return device_us * 1000 + sorted(self._offsets_ns)[len(self._offsets_ns) // 2]
