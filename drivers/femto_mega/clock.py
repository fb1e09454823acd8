"""From the camera's clock to this computer's, and how well that is known. UTC, which may be set, plays no part."""

from __future__ import annotations

from collections import deque

_KEPT = 60
_FEWEST = 10
_JUMP_US = 500_000
"""More than any delay on the way here varies by."""
_EARLIEST_US, _LATEST_US = -500_000, 5_000_000
"""A frame arrives after its exposure began, and not much later: beyond this the SDK's fit is of another clock."""
_ROUND_TRIP_NS = 1_000_000
"""What half a round trip to the camera may hide in every sample."""


class DeviceClock:
    """Learns the offset between the camera's clock and the host's monotonic one, and notices when one of them jumps.

    Attributes:
        jumps: how often what was learnt was wrong from then on, since this was made.
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=_KEPT)
        self._last: tuple[int, int] | None = None
        self.jumps = 0

    def hear(self, device_us: int, global_us: int, arrived_ns: int) -> bool:
        """One frame's stamps: the camera's, the same by the host's clock from the SDK (0 = not known), its arrival.

        Returns: False when the camera's clock has jumped, or the SDK's fit cannot be: what was learnt is forgotten.
        """
        last, self._last = self._last, (device_us, arrived_ns)
        jumped = last is not None and abs((device_us - last[0]) - (arrived_ns - last[1]) // 1000) > _JUMP_US
        if jumped or (global_us != 0 and not _EARLIEST_US <= arrived_ns // 1000 - global_us <= _LATEST_US):
            self.jumps += 1
            self._offsets_ns.clear()
            return False
        if global_us != 0:
            possible_us = min(global_us, (arrived_ns + _ROUND_TRIP_NS) // 1000)  # none is exposed after it arrived
            self._offsets_ns.append((possible_us - device_us) * 1000)
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

    def host_ns(self, device_us: int) -> int:
        """A stamp of the camera by the host's clock [ns]; only when `is_known`."""
        return device_us * 1000 + sorted(self._offsets_ns)[len(self._offsets_ns) // 2]
