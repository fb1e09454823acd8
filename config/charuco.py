"""The calibration board itself: what is printed, laid on the simulated table and looked for is one and the same."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from config.calibration import CalibrationSettings


def charuco_board(settings: CalibrationSettings) -> cv2.aruco.CharucoBoard:
    """Return the board of these settings."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, settings.dictionary))
    return cv2.aruco.CharucoBoard(settings.squares, settings.square_m, settings.marker_m, dictionary)


def board_image(settings: CalibrationSettings, pixels_per_m: float) -> npt.NDArray[np.uint8]:
    """Return the board as it is printed, without a margin (H, W) grey."""
    width, height = (round(side * pixels_per_m) for side in settings.size_m)
    return np.asarray(charuco_board(settings).generateImage((width, height)))
