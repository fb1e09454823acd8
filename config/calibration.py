"""Settings of the camera's mounting calibration: the board, its place, and the accepted error."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from config.base import Finite, Positive, Settings, Vector

_SIZES = {"50": 50, "100": 100, "250": 250, "1000": 1000}
MARKERS = {f"DICT_{bits}X{bits}_{name}": count for bits in (4, 5, 6, 7) for name, count in _SIZES.items()} | {
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}
"""Number of markers in each of OpenCV's predefined dictionaries, by name."""
_LARGEST_M = 1.5


def _spelled(dictionary: str) -> str:
    """Lower the H: OpenCV has the names with an H in both spellings."""
    return dictionary.replace("H", "h")


class CalibrationSettings(Settings):
    """A ChArUco board (`cell calibrate board` prints it), flat on the table.

    Attributes:
        squares: (along its x, along its y). ``square_m``, ``marker_m``: sides of a square and of the marker in it.
        dictionary: name of OpenCV's predefined marker dictionary.
        board_center_m: rough position of its middle in ``base``; ``board_yaw_rad``: its rotation about z.
        poses: number of viewpoints.
        max_rms_px: largest accepted re-projection error; ``max_off_px``: largest accepted deviation of `check`.
    """

    squares: tuple[Annotated[int, Field(ge=4, le=30)], Annotated[int, Field(ge=4, le=30)]] = (7, 5)
    square_m: Annotated[float, Field(ge=0.01, le=0.2)] = 0.040
    marker_m: Positive = 0.030
    dictionary: Annotated[str, AfterValidator(_spelled)] = "DICT_5X5_100"
    board_center_m: Vector = (0.45, 0.0, 0.0)
    board_yaw_rad: Finite = 0.0
    poses: Annotated[int, Field(ge=12, le=60)] = 15
    max_rms_px: Positive = 1.0
    max_off_px: Positive = 1.0

    @model_validator(mode="after")
    def _can_be_printed(self) -> CalibrationSettings:
        if not self.square_m / 3 <= self.marker_m < self.square_m:
            raise ValueError(f"a marker of {self.marker_m} m does not fit into a square of {self.square_m} m")
        if max(self.size_m) > _LARGEST_M:
            raise ValueError(f"a board of {self.size_m[0]:.2f} x {self.size_m[1]:.2f} m: more than {_LARGEST_M} m")
        holds = MARKERS.get(self.dictionary)
        if holds is None:
            raise ValueError(f"OpenCV has no marker dictionary {self.dictionary!r}; take DICT_5X5_100, say")
        needed = self.squares[0] * self.squares[1] // 2
        if needed > holds:
            columns, rows = self.squares
            raise ValueError(f"{columns} x {rows} squares need {needed} markers; {self.dictionary} holds only {holds}")
        return self

    @property
    def size_m(self) -> tuple[float, float]:
        """Size of the whole board along its x and y."""
        return self.squares[0] * self.square_m, self.squares[1] * self.square_m
