"""How the camera's mounting is calibrated: the board, where it lies, and when the result is good."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from config.base import Finite, Positive, Settings, Vector


class CalibrationSettings(Settings):
    """A ChArUco board (`cell calibrate board` prints it), flat on the table.

    Attributes:
        squares: (along its x, along its y). ``square_m``, ``marker_m``: sides of a square and of the marker in it.
        dictionary: name of OpenCV's predefined marker dictionary.
        board_center_m: roughly where its middle lies in ``base``; ``board_yaw_rad``: how it is turned about z.
        poses: from how many places it is looked at.
        max_rms_px: a re-projection error beyond it is refused; ``max_off_px``: by how much `check` may be off.
    """

    squares: tuple[Annotated[int, Field(ge=4, le=30)], Annotated[int, Field(ge=4, le=30)]] = (7, 5)
    square_m: Positive = 0.040
    marker_m: Positive = 0.030
    dictionary: str = "DICT_5X5_100"
    board_center_m: Vector = (0.45, 0.0, 0.0)
    board_yaw_rad: Finite = 0.0
    poses: Annotated[int, Field(ge=12, le=60)] = 15
    max_rms_px: Positive = 1.0
    max_off_px: Positive = 1.0

    @model_validator(mode="after")
    def _marker_in_square(self) -> CalibrationSettings:
        if self.marker_m >= self.square_m:
            raise ValueError(f"a marker of {self.marker_m} m does not fit into a square of {self.square_m} m")
        return self

    @property
    def size_m(self) -> tuple[float, float]:
        """Of the whole board, along its x and y."""
        return self.squares[0] * self.square_m, self.squares[1] * self.square_m
