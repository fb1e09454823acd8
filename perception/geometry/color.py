"""Colours: OpenCV's hue."""

from __future__ import annotations

import cv2
import numpy as np


def hue_of(rgb: tuple[int, int, int]) -> int:
    """OpenCV's hue, 0 to 179, of a colour (r, g, b)."""
    return int(cv2.cvtColor(np.array([[rgb]], dtype=np.uint8), cv2.COLOR_RGB2HSV)[0, 0, 0])
