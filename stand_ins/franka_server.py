"""The strict FR3 simulator on loopback; runs in the environment of franka-sim (`stand_ins.franka` starts it)."""

import argparse
import contextlib
import ctypes
import logging
import os
import signal
from pathlib import Path

from franka_sim import FrankaSimServer

_PR_SET_PDEATHSIG = 1


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--object-width-m", type=float)
    asked = options.parse_args()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)  # an orphan would keep the ports
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background commands ignore it
    with contextlib.suppress(OSError):  # it stands for a robot, which is never late; only root may ask for that
        os.nice(-10)
        Path("/proc/self/autogroup").write_text("-10")
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    server = FrankaSimServer(
        host="127.0.0.1",
        gripper_physics=True,
        gripper_object_width=asked.object_width_m,
        enforce_comm_constraints=True,
        enforce_motion_limits=True,
    )
    server.start()


if __name__ == "__main__":
    main()
