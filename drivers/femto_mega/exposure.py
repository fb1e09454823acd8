"""Detects when a camera's automatic exposure has settled."""

from __future__ import annotations

_STEADY = 0.05
_STEADY_FRAMES = 5


class Settled:
    """Settled means: enough pictures passed, and the size of the last five (a measure of content) varies by < 5 %.

    A scene that never becomes steady counts as settled after three times as many pictures.

    Args:
        frames: number of pictures that are enough.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._sizes: list[int] = []
        self.is_done = False

    def after(self, size: int) -> bool:
        """Add one more picture of ``size`` bytes; return whether the exposure has settled."""
        if not self.is_done:
            self._sizes.append(size)
            last = self._sizes[-_STEADY_FRAMES:]
            steady = max(last) - min(last) <= _STEADY * max(last)
            enough = len(self._sizes) >= self._frames
            self.is_done = enough and (steady or len(self._sizes) >= 3 * self._frames)
        return self.is_done
