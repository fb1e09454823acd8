"""A hand of another make as the cell's `Hand`. The lines marked SDK are where the maker's package comes in."""

from __future__ import annotations

import time

from pydantic import BaseModel, ConfigDict, Field

from bus.errors import HandFault, NotConnected
from bus.messages import HandState
from config.plug_ins import with_settings
from config.schema import Station
from drivers.interface import Devices
from drivers.motion.stops import Stops


class GripperSettings(BaseModel):
    """`[nodes.NAME.settings]` of the station.

    Attributes:
        port: where the gripper is connected. ``poll_s``: how often its width is read while it moves.
    """

    model_config = ConfigDict(extra="forbid")
    port: str = "/dev/ttyUSB0"
    poll_s: float = Field(default=0.01, gt=0, le=0.05)


class AcmeGripper:
    """Two parallel fingers. `state` and `stop` are called by other threads than `move`, `grasp` and `home`."""

    def __init__(self, station: Station, settings: GripperSettings) -> None:
        self._settings = settings
        self._widest_m = station.hand.max_width_m
        self._width_m = 0.0  # SDK: what the gripper measures
        self._is_connected = self._is_homed = self._is_moving = False
        self._stops = Stops()

    def connect(self) -> None:
        self._is_connected = True  # SDK: open settings.port; raise DriverUnavailable, with what to do, when it fails

    def close(self) -> None:
        self.stop()
        self._is_connected = False

    def state(self) -> HandState:
        """Asked for 20 times a second, also while the fingers move: it must not wait for them."""
        if not self._is_connected:
            raise NotConnected("The gripper is not connected.", "Call connect() first.")
        return HandState(
            stamp_ns=time.time_ns(), width_m=self._width_m, is_moving=self._is_moving, is_homed=self._is_homed
        )

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        if not 0 <= width_m <= self._widest_m:
            raise HandFault(f"The gripper cannot open to {width_m} m.", f"Ask for 0 to {self._widest_m} m.")
        return self._drive(width_m, speed_m_s)

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        return self._drive(0.0, speed_m_s)  # SDK: close until something is felt, and keep pressing

    def home(self) -> HandState:
        self._is_homed = True
        return self._drive(self._widest_m, 0.1)

    def stop(self) -> None:
        self._stops.stop()

    def _drive(self, width_m: float, speed_m_s: float) -> HandState:
        self.state()
        stopped = self._stops.asked()
        self._is_moving = True
        while abs(width_m - self._width_m) > 1e-6 and not stopped():  # SDK: the gripper does this
            step_m = speed_m_s * self._settings.poll_s
            self._width_m += min(step_m, max(-step_m, width_m - self._width_m))
            time.sleep(self._settings.poll_s)
        self._is_moving = False
        return self.state()


@with_settings(GripperSettings)
def open_devices(station: Station, settings: GripperSettings) -> Devices:
    """Build the devices, without connecting them: the entry point names this function."""
    return Devices(hand=AcmeGripper(station, settings))
