"""A picture of now, for somebody who looks at a cell that rests, or who points at what it shall pick."""

from __future__ import annotations

from typing import Literal

from bus.arrays import Blob
from bus.frozen import Message

PictureType = Literal["image/png", "image/jpeg"]


class PictureRequest(Message):
    """The kind of picture that is wanted.

    Attributes:
        media_type: of the file.
        from_capture_pose: only one that was taken from where the cell looks for things: a pixel of it is a target.
    """

    media_type: PictureType = "image/png"
    from_capture_pose: bool = True


class LivePicture(Message):
    """The undistorted colour image, taken when it was asked for; of no cycle, and in no recording.

    Attributes:
        media_type: of ``data``.
        stamp_ns: of the frame, UTC; `bus.messages.Target.picture_ns` of who points into it.
        data: the file, RGB, of ``media_type``. A PNG file has a text chunk ``pick region``, JSON: that region's corners
            on the table, [[u, v], ...] in its pixels. What lies beyond, as in the tray, is no target.
        from_capture_pose: it was taken from where the cell looks for things: one may point into it.
        things_ns: the stamp of the last picture in which things were found, where it was taken from the same place: its
            outlines fit this one, as long as nobody has moved anything; 0 = they do not, or the fingers have closed
            among them since, in a cycle that did not end in SUCCESS.
        gone: numbers of the things among them that the cell has picked since, with those that touched them.
    """

    stamp_ns: int
    data: Blob
    media_type: PictureType
    from_capture_pose: bool
    things_ns: int = 0
    gone: tuple[int, ...] = ()
