"""EGL, with which MuJoCo draws without a screen: chosen here, and what to do where it does not draw."""

from __future__ import annotations

import os

_CHOICES = ("MUJOCO_GL", "PYOPENGL_PLATFORM")
"""Variables that people set for other programs; each chooses who draws. MuJoCo sets the second by the first."""


def choose() -> None:
    """Let MuJoCo draw through EGL unless the environment says otherwise. MuJoCo reads it when it is first imported."""
    if not os.environ.get("MUJOCO_GL"):  # an empty one means a window of GLFW to MuJoCo
        os.environ["MUJOCO_GL"] = "egl"


def advice() -> str:
    """Return the advice where nothing can be drawn: unset what asks for another way to draw; else install EGL."""
    for name in _CHOICES:
        if (chosen := os.environ.get(name, "")) not in ("", "egl"):
            return f"Unset {name} (it says {chosen}): EGL draws then."
    return "Install EGL: apt-get install libegl1 libgl1-mesa-dri (./setup.sh does)."
