"""The simulated cell: camera, arm and hand of one MuJoCo world.

Objects are held by contact forces only: an object that is not gripped falls.
"""

from bus.errors import DriverUnavailable
from drivers import egl

egl.choose()
try:
    import mujoco as _mujoco  # noqa: F401
except (ImportError, RuntimeError, AttributeError, OSError) as error:  # what a missing GL library raises varies
    raise DriverUnavailable(f"MuJoCo cannot be imported: {error}.", egl.advice()) from error
