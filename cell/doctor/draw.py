"""Draws one small picture as the simulated camera does, and prints how long it took. Fails where drawing fails."""

from __future__ import annotations

import sys
import time

import mujoco

from bus.errors import DriverUnavailable
from drivers.sim.render import Painter

SIDE = 64
_WHITE_BALL = "<mujoco><worldbody><camera name='eye' pos='0 0 1'/><geom size='.2' rgba='1 1 1 1'/></worldbody></mujoco>"


def main() -> int:
    """Draw, and return the exit code: 0 when the picture is right, else 1."""
    model = mujoco.MjModel.from_xml_string(_WHITE_BALL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    started_s = time.monotonic()
    try:
        painter = Painter(model)
    except DriverUnavailable as error:
        sys.stderr.write(f"{error.text}\n")
        return 1
    painter.look(data, "eye")
    pixels = painter.color(SIDE, SIDE)
    painter.close()
    if not pixels[SIDE // 2, SIDE // 2].max() > pixels[0, 0].max():
        sys.stderr.write("the picture stays black\n")
        return 1
    took_ms = (time.monotonic() - started_s) * 1e3
    sys.stdout.write(f"MuJoCo draws without a screen; a picture of {SIDE} x {SIDE} took {took_ms:.0f} ms\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
