"""The simulated cell: camera, arm and hand of one MuJoCo world.

Objects are held by contact forces only: an object that is not gripped falls.
"""

import os

from bus.errors import DriverUnavailable

os.environ.setdefault("MUJOCO_GL", "egl")  # headless; MuJoCo reads it when it is first imported
try:
    import mujoco as _mujoco  # noqa: F401
except (ImportError, RuntimeError, AttributeError, OSError) as error:  # what a missing GL library raises varies
    raise DriverUnavailable(
        f"MuJoCo cannot be imported: {error}.",
        "Install EGL (apt-get install libegl1 libgl1-mesa-dri) and leave MUJOCO_GL unset or =egl.",
    ) from error
