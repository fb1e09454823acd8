"""From where a look was taken, in words."""

from __future__ import annotations

from bus.arrays import Transform
from bus.transforms import direction_of_view_deg

_LEVEL_DEG = 3.0
"""A look tilted by less is one from above, of whatever azimuth."""


def direction_in_words(base_from_color: Transform) -> str:
    """From where the camera (4, 4) looks: tilt from the vertical; azimuth 0 is beyond the place, 90 on its left."""
    tilt_deg, azimuth_deg = direction_of_view_deg(base_from_color)
    if tilt_deg < _LEVEL_DEG:
        return "from above"
    return f"tilt {tilt_deg:.0f}°, azimuth {azimuth_deg:.0f}°"
