"""The cell's camera, and how large its pictures are: what is pointed at outside of them is refused at the door."""

from __future__ import annotations

from bus.messages import Frame
from drivers.interface import Camera


class SizedCamera:
    """A camera that knows the size of its newest picture; a reset takes one, so every job finds it known.

    Attributes:
        size_px: width and height of the colour image; None before the first. Any thread may read it.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self.size_px: tuple[int, int] | None = None

    def connect(self) -> None:
        """As `Camera.connect`."""
        self._camera.connect()

    def capture(self) -> Frame:
        """As `Camera.capture`."""
        frame = self._camera.capture()
        self.size_px = frame.color_camera.width, frame.color_camera.height
        return frame

    def close(self) -> None:
        """As `Camera.close`."""
        self._camera.close()
