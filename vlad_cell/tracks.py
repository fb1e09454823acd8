"""The arm and the hand of a recorded cycle over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vlad_cell.detection import counted


@dataclass(frozen=True, eq=False)
class JointTrack:
    """The arm over time, every 10 ms while it moves.

    Attributes:
        time_s: (n,) seconds of the robot's time since the first look, ascending; negative before it.
        q_rad, dq_rad_s, tau_ext_nm: (n, joints) joint positions, velocities and external torques, base to wrist.
    """

    time_s: npt.NDArray[np.float64]
    q_rad: npt.NDArray[np.float64]
    dq_rad_s: npt.NDArray[np.float64]
    tau_ext_nm: npt.NDArray[np.float64]

    def __repr__(self) -> str:
        return f"JointTrack: {counted(self.q_rad.shape[1], 'joint')}, {_spanned(self.time_s)}"


@dataclass(frozen=True, eq=False)
class HandTrack:
    """The hand over time.

    Attributes:
        time_s: (n,) as in `JointTrack`. ``width_m``: (n,) distance between the finger pads.
    """

    time_s: npt.NDArray[np.float64]
    width_m: npt.NDArray[np.float64]

    def __repr__(self) -> str:
        widths = f", {self.width_m.min() * 1e3:.0f} to {self.width_m.max() * 1e3:.0f} mm" if self.width_m.size else ""
        return f"HandTrack: {_spanned(self.time_s)}{widths}"


def _spanned(time_s: npt.NDArray[np.float64]) -> str:
    """Return how many samples there are, and when."""
    times = f", {time_s.min():.2f} to {time_s.max():.2f} s" if time_s.size else ""
    return f"{counted(time_s.size, 'sample')}{times}"
