"""Maps the camera's clock to this computer's monotonic clock (never to UTC, which may be set), and bounds the error."""

from __future__ import annotations

from collections import deque

_KEPT = 60
_FEWEST = 10
_JUMP_US = 500_000
"""A larger change of the offset is a jump: transport delays vary by less."""
_EARLIEST_US, _LATEST_US = -500_000, 5_000_000
"""Allowed delay between exposure and arrival: outside of it the SDK's fit belongs to another clock."""
_ROUND_TRIP_NS = 1_000_000
"""Error of every sample by half a round trip to the camera."""


class DeviceClock:
    """Learns the offset between the camera's clock and the host's monotonic one, and detects jumps of either.

    Attributes:
        jumps: number of jumps so far; each discards the learnt offset.
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=_KEPT)
        self._last: tuple[int, int] | None = None
        self.jumps = 0

    def hear(self, device_us: int, global_us: int, arrived_ns: int) -> bool:
        """Add one frame's stamps.

        Args:
            device_us: start of the exposure by the camera's clock.
            global_us: the same by the host's monotonic clock, from the SDK's fit; 0 = not known.
            arrived_ns: arrival by the host's monotonic clock.

        Returns:
            False when the camera's clock has jumped or the SDK's fit is impossible; the offset is then discarded.
        """
        last, self._last = self._last, (device_us, arrived_ns)
        jumped = last is not None and abs((device_us - last[0]) - (arrived_ns - last[1]) // 1000) > _JUMP_US
        if jumped or (global_us != 0 and not _EARLIEST_US <= arrived_ns // 1000 - global_us <= _LATEST_US):
            self.jumps += 1
            self._offsets_ns.clear()
            return False
        if global_us != 0:
            possible_us = min(global_us, (arrived_ns + _ROUND_TRIP_NS) // 1000)  # no frame is exposed after its arrival
            self._offsets_ns.append((possible_us - device_us) * 1000)
        return True

    def forget(self) -> None:
        """Discard the learnt offset, after a reconnection."""
        self._offsets_ns.clear()
        self._last = None

    @property
    def is_known(self) -> bool:
        """Whether enough frames were heard for `host_ns`."""
        return len(self._offsets_ns) >= _FEWEST

    @property
    def error_ns(self) -> int:
        """Error bound: half of the offset's recent spread, plus half a round trip; 0 before the first frame."""
        return (max(self._offsets_ns) - min(self._offsets_ns)) // 2 + _ROUND_TRIP_NS if self._offsets_ns else 0

    def host_ns(self, device_us: int) -> int:
        """Convert a stamp of the camera to the host's monotonic clock [ns]; only when `is_known`."""
        return device_us * 1000 + sorted(self._offsets_ns)[len(self._offsets_ns) // 2]
