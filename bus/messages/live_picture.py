"""A picture of now, for somebody who looks at a cell that rests."""

from __future__ import annotations

from bus.arrays import Blob
from bus.frozen import Message


class LivePicture(Message):
    """The undistorted colour image, taken when it was asked for; of no cycle, and in no recording.

    Attributes:
        stamp_ns: of the frame, UTC. ``jpeg``: the file.
        from_capture_pose: it was taken from where the cell looks for things: one may point into it.
        things_ns: the stamp of the last picture in which things were found, where it was taken from the same place: its
            outlines fit this one, as long as nobody has moved anything; 0 = they do not.
        gone: numbers of the things among them that the cell has picked since.
    """

    stamp_ns: int
    jpeg: Blob
    from_capture_pose: bool
    things_ns: int = 0
    gone: tuple[int, ...] = ()
