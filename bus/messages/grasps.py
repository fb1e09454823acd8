"""The shape of a grasp: in the image, and in the base frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bus.arrays import Transform
from bus.frozen import Message
from bus.lazy import LazyModule

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
else:
    np = LazyModule("numpy")


class Rectangle(Message):
    """A grasp rectangle in the undistorted colour image (Jiang et al. 2011).

    Attributes:
        center_px: (u, v).
        angle_rad: direction of the closing axis in the image, in [0, pi).
        width_px: jaw opening, along the closing axis (lambda x run).
        height_px: jaw height, across it.
    """

    center_px: tuple[float, float]
    angle_rad: float
    width_px: float
    height_px: float

    def corners_px(self) -> npt.NDArray[np.float64]:
        """Its corners (4, 2) as (u, v), one after the other; the first side lies along the closing axis."""
        along = np.array([np.cos(self.angle_rad), np.sin(self.angle_rad)]) * self.width_px / 2
        across = np.array([-np.sin(self.angle_rad), np.cos(self.angle_rad)]) * self.height_px / 2
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        return np.asarray(np.array(self.center_px) + signs[:, :1] * along + signs[:, 1:] * across)


class Grasp(Message):
    """A 6-DoF grasp for a parallel hand.

    Attributes:
        terms: the parts of the score, by name.
        base_from_tcp: (4, 4) [m]: tcp z = approach direction, tcp y = closing axis, origin between the pads.
        width_m: object width between the pads; ``opening_m``: hand width to approach with.
        score: higher is better; the weighted mean of ``terms``, each named and between 0 and 1.
        instance: number of the thing it holds (`bus.messages.ObservedScene`). ``rectangle``: index of the rectangle it
            came from.
        imagined_base_from_tcp: (4, 4), the same grasp as the transferred rod gives it, before the snap to the surface.
    """

    base_from_tcp: Transform
    width_m: float
    opening_m: float
    score: float
    rectangle: int
    imagined_base_from_tcp: Transform
    terms: dict[str, float]
    instance: int = 0
