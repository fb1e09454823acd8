"""Whether a camera's automatic exposure has come to rest."""

from __future__ import annotations

_STEADY = 0.05
_STEADY_FRAMES = 5


class Settled:
    """Enough pictures passed, and their size (so their content) is steady.

    A scene that never is steady counts as settled after three times as many.

    Args:
        frames: how many are enough.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._sizes: list[int] = []
        self.is_done = False

    def after(self, size: int) -> bool:
        """Whether it has, after one more picture of ``size`` bytes."""
        if not self.is_done:
            self._sizes.append(size)
            last = self._sizes[-_STEADY_FRAMES:]
            steady = max(last) - min(last) <= _STEADY * max(last)
            enough = len(self._sizes) >= self._frames
            self.is_done = enough and (steady or len(self._sizes) >= 3 * self._frames)
        return self.is_done
