"""The simulated cell: camera, arm and hand of one MuJoCo world. No magic attach: what is not gripped falls."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")  # headless; MuJoCo reads it when it is first imported
