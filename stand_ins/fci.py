"""The package ``pylibfranka`` as far as the control loop uses it: a robot that follows every command immediately."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

IDLE, MOVE = 1, 2


class FakeFci:
    """One robot.

    Args:
        on_cycle: called before every answer of the robot, with the number of the cycle.

    Attributes:
        tau_ext_nm: (7,) external torques on its joints, by our sign: the robot tells their negative.
    """

    def __init__(self, q_rad: np.ndarray, on_cycle: Callable[[int], None]) -> None:
        self.tau_ext_nm = np.zeros(7)
        self.q_rad, self._on_cycle, self._cycle, self._mode = q_rad, on_cycle, 0, IDLE

    def package(self) -> Any:
        """Return what ``import pylibfranka`` would give."""
        return SimpleNamespace(
            RealtimeConfig=SimpleNamespace(kEnforce=1, kIgnore=0),
            ControllerMode=SimpleNamespace(JointImpedance=0),
            JointPositions=lambda q_rad: SimpleNamespace(q_rad=q_rad, motion_finished=False),
            Robot=lambda *_: self,
        )

    # --- as Robot -----------------------------------------------------------------------------------------------------

    def set_collision_behavior(self, *_: Any) -> None: ...

    def set_joint_impedance(self, *_: Any) -> None: ...

    def set_load(self, *_: Any) -> None: ...

    def read_once(self) -> Any:
        q_rad = self.q_rad.tolist()
        return SimpleNamespace(q=q_rad, q_d=q_rad, dq=[0.0] * 7, tau_ext_hat_filtered=(-self.tau_ext_nm).tolist(),
                               robot_mode=self._mode, control_command_success_rate=1.0)  # fmt: skip

    def start_joint_position_control(self, _mode: int) -> FakeFci:
        self._mode = MOVE
        return self

    # --- as its active control ----------------------------------------------------------------------------------------

    def readOnce(self) -> tuple[Any, Any]:
        self._on_cycle(self._cycle)
        self._cycle += 1
        return self.read_once(), SimpleNamespace(to_sec=lambda: 1e-3)

    def writeOnce(self, positions: Any) -> None:
        self.q_rad = np.array(positions.q_rad)
        self._mode = IDLE if positions.motion_finished else MOVE
