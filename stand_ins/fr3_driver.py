"""``python -m stand_ins.fr3_driver ADDRESS``: an FR3's driver alone in a process, to be frozen during a motion.

It prints ``moving`` once the arm moves, and the outcome of that motion, and of a short one after it.
"""

import sys
import threading
import time

import numpy as np

from bus.trajectory import TICK_S, Trajectory
from config.hardware import Fr3Settings
from config.load import load_station
from drivers.fr3.arm import Fr3Arm


def main() -> None:
    here = Fr3Settings(address=sys.argv[1], realtime="ignore")
    arm = Fr3Arm(load_station().model_copy(update={"fr3": here}))
    arm.connect()
    start_q_rad = arm.state().q_rad
    playing = threading.Thread(target=lambda: _play(arm, 0.8, 5.0))
    playing.start()
    while np.abs(arm.state().q_rad - start_q_rad).max() < 0.1:
        time.sleep(0.002)
    print("moving", flush=True)  # noqa: T201
    playing.join()
    _play(arm, 0.1, 2.0)
    arm.close()


def _play(arm: Fr3Arm, by_rad: float, duration_s: float) -> None:
    """Joint 7 there and back."""
    raw_q_rad = np.repeat(arm.state().q_rad[None], round(duration_s / TICK_S), axis=0)
    raw_q_rad[:, 6] += by_rad * (0.5 - 0.5 * np.cos(np.linspace(0.0, 2 * np.pi, len(raw_q_rad)))) ** 2
    motion = arm.execute(Trajectory(raw_q_rad=raw_q_rad, window=64))
    print(f"finished {motion.finished}, {arm.state().mode.value}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
