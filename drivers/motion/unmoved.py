"""The outcome of a motion that never began."""

from __future__ import annotations

import numpy as np

from bus.messages import ArmState, Motion
from bus.trajectory import Trajectory


def unmoved(state: ArmState, trajectory: Trajectory) -> Motion:
    """Return the outcome of ``trajectory`` stopped before its first step; ``state``: measured meanwhile."""
    return Motion(
        finished=False,
        commanded_q_rad=trajectory.start_q_rad[None],
        t_s=np.zeros(1),
        q_rad=state.q_rad[None],
        dq_rad_s=state.dq_rad_s[None],
        tau_ext_nm=state.tau_ext_nm[None],
    )
