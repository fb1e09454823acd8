"""Devices with injected faults: each wraps a Camera, Arm or Hand, to test the cell's reactions.

The fault may be changed at any time, from any thread (``arm.fault = Fault.OFF``). ``off``: everything but ``close``,
``stop`` and ``hold`` raises `bus.errors.DeviceLost`, and a moving arm brakes. ``stuck``: the device repeats its last
answer, stamp included, and carries nothing out. ``slow``: each answer comes ``delay_s`` late. ``stop``, ``hold`` and
``close`` reach the wrapped device at once under every fault: an injected fault never keeps a stop from a real arm.
``wrong`` moves the arm elsewhere than planned: for simulators, and for an arm with nothing in its reach.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from bus.errors import DeviceLost
from bus.fault_injection import Fault
from bus.faulty_bus import Faulty, FaultyBus, Spoilable, answer_faults
from bus.messages import ArmState, Frame, HandState, Motion
from bus.session import Bus
from bus.trajectory import Trajectory
from config.fault_injection import FaultSettings
from drivers.interface import Arm, Camera, Devices, Hand, Reporting
from drivers.motion.stops import Stops
from drivers.motion.unmoved import unmoved

WRONG_JOINT_RAD = 0.1
"""Offset of every joint: encoders that lost their zero."""
WRONG_WIDTH_M = 0.01
ABSURD_WIDTH_M = 5.0

DeviceT = TypeVar("DeviceT", Camera, Arm, Hand)
SaidT = TypeVar("SaidT", Frame, ArmState, HandState)
AnswerT = TypeVar("AnswerT")


class _Device(Faulty, Generic[DeviceT, SaidT]):
    """Common base of the three wrappers.

    Args:
        device: the wrapped device; not yet connected.
        delay_s: delay of every answer under ``slow``.
    """

    def __init__(self, device: DeviceT, fault: Fault = Fault.NONE, *, delay_s: float = 1.0) -> None:
        super().__init__(fault, delay_s)
        self._device: DeviceT = device
        self._last: SaidT | None = None  # guarded by `_turn`
        self._counter = itertools.count()

    def _on_fault(self, fault: Fault) -> None:
        if fault is Fault.OFF:
            self._lose_power()

    def connect(self) -> None:
        """Connect the wrapped device. Raises: DeviceLost under ``off``."""
        self._ask(self._device.connect)

    def close(self) -> None:
        """Close the wrapped device, and forget its last answer."""
        self._device.close()
        with self._turn:
            self._last = None

    def readings(self) -> dict[str, float]:
        """Return those of the wrapped device, if it has any; none under ``off``."""
        if self._fault is Fault.OFF or not isinstance(self._device, Reporting):
            return {}
        return self._device.readings()

    def _lose_power(self) -> None:
        """Hook for subclasses: the device's reaction to losing power."""

    def _ask(self, act: Callable[[], AnswerT]) -> AnswerT:
        """Return the wrapped device's answer: late under ``slow``. Raises: DeviceLost when off before or after."""
        self._require_on()
        answer = act()
        self._tarry()
        self._require_on()
        return answer

    def _require_on(self) -> None:
        if self._fault is Fault.OFF:
            name = type(self).__name__.removeprefix("Faulty").lower()
            raise DeviceLost(f"The {name} no longer answers (injected fault).", "Set its fault to 'none'.")

    def _tarry(self) -> None:
        if self._fault is Fault.SLOW:
            time.sleep(self.delay_s)

    def _unless_stuck(self, said: SaidT) -> SaidT:
        """Return ``said``; under ``stuck``, the answer before it."""
        with self._turn:
            if self._last is None or self._fault is not Fault.STUCK:
                self._last = said
            return self._last


class FaultyCamera(_Device[Camera, Frame]):
    """A camera with faults.

    ``garbage``: in turns a black image with zero depth, and noise without depth. ``wrong``: a mirrored colour image.
    """

    def capture(self) -> Frame:
        """Capture as `Camera.capture`, changed as the fault says. Raises: DeviceLost under ``off``."""
        frame = self._unless_stuck(self._ask(self._device.capture))
        if self._fault is Fault.GARBAGE:
            return _garbled(frame, next(self._counter))
        if self._fault is Fault.WRONG:
            return frame.model_copy(update={"color": np.ascontiguousarray(frame.color[:, ::-1])})
        return frame


def _garbled(frame: Frame, number: int) -> Frame:
    if number % 2 == 0:
        return frame.model_copy(
            update={"color": np.zeros_like(frame.color), "depth_m": np.zeros_like(frame.depth_m)},
        )
    noise = np.random.default_rng(number).integers(0, 256, frame.color.shape, np.uint8)
    return frame.model_copy(update={"color": noise, "depth_m": np.full_like(frame.depth_m, np.nan)})


class FaultyArm(_Device[Arm, ArmState]):
    """An arm with faults; the offset of ``wrong`` is 0.1 rad.

    ``garbage``: NaN in every joint. ``wrong``: `WRONG_JOINT_RAD` added to measured positions, subtracted from commands.
    ``stuck``: ``execute`` moves nothing and returns only after a ``stop``, a ``close`` or another fault.
    """

    def __init__(self, device: Arm, fault: Fault = Fault.NONE, *, delay_s: float = 1.0) -> None:
        super().__init__(device, fault, delay_s=delay_s)
        self._stops = Stops()

    def state(self) -> ArmState:
        """Return the state, changed as the fault says. Raises: DeviceLost under ``off``."""
        state = self._unless_stuck(self._ask(self._device.state))
        if self._fault is Fault.GARBAGE:
            none = np.full(len(state.q_rad), np.nan)
            return state.model_copy(update={"q_rad": none, "dq_rad_s": none, "tau_ext_nm": none})
        if self._fault is Fault.WRONG:
            return state.model_copy(update={"q_rad": state.q_rad + WRONG_JOINT_RAD})
        return state

    def execute(self, trajectory: Trajectory) -> Motion:
        """Execute as `Arm.execute`, changed as the fault says. Raises: DeviceLost under ``off``."""
        fault, stopped = self._fault, self._stops.asked()
        if fault is Fault.STUCK:
            motion = unmoved(self._device.state(), trajectory)
        elif fault is Fault.WRONG:
            told = trajectory.model_copy(update={"raw_q_rad": trajectory.raw_q_rad - WRONG_JOINT_RAD})
            motion = _turned(self._ask(lambda: self._play(told, stopped)))
        else:
            motion = self._ask(lambda: self._play(trajectory, stopped))
        if self._fault is Fault.STUCK:
            motion = motion.model_copy(update={"finished": False})
            with self._turn:
                self._turn.wait_for(lambda: stopped() or self._fault is not Fault.STUCK)
        self._require_on()
        return _unreadable(motion) if fault is Fault.GARBAGE else motion

    def _play(self, trajectory: Trajectory, stopped: Callable[[], bool]) -> Motion:
        return unmoved(self._device.state(), trajectory) if stopped() else self._device.execute(trajectory)

    def _stop_all(self) -> None:
        self._stops.stop()
        self._device.stop()
        with self._turn:
            self._turn.notify_all()

    def stop(self) -> None:
        """Stop the wrapped arm at once under every fault; return late under ``slow``."""
        self._stop_all()
        self._tarry()

    def hold(self) -> None:
        """Hold the wrapped arm at once under every fault; return late under ``slow``."""
        self._device.hold()
        self._tarry()

    def resume(self) -> None:
        """Resume the wrapped arm. Raises: DeviceLost under ``off``."""
        self._ask(self._device.resume)

    def recover(self) -> None:
        """Recover the wrapped arm. Raises: DeviceLost under ``off``."""
        self._ask(self._device.recover)

    def close(self) -> None:
        """Close the wrapped arm, and end an ``execute`` that is stuck."""
        super().close()
        self._stop_all()

    def _lose_power(self) -> None:
        self._stop_all()


def _turned(motion: Motion) -> Motion:
    """Return the motion in the joint coordinates of the arm's wrong zero."""
    believed = {name: getattr(motion, name) + WRONG_JOINT_RAD for name in ("commanded_q_rad", "q_rad")}
    return motion.model_copy(update=believed)


def _unreadable(motion: Motion) -> Motion:
    measured = ("q_rad", "dq_rad_s", "tau_ext_nm")
    return motion.model_copy(update={name: np.full_like(getattr(motion, name), np.nan) for name in measured})


class FaultyHand(_Device[Hand, HandState]):
    """A hand with faults. ``garbage``: in turns a width of NaN and of `ABSURD_WIDTH_M`. ``wrong``: 10 mm too wide."""

    def state(self) -> HandState:
        """Return the state, changed as the fault says. Raises: DeviceLost under ``off``."""
        return self._measured(self._device.state)

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Move to ``width_m`` as `Hand.move`, changed as the fault says. Raises: DeviceLost under ``off``."""
        return self._measured(lambda: self._device.move(width_m, speed_m_s), moves=True)

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Grasp with ``force_n`` as `Hand.grasp`, changed as the fault says. Raises: DeviceLost under ``off``."""
        return self._measured(lambda: self._device.grasp(force_n, speed_m_s), moves=True)

    def home(self) -> HandState:
        """Home as `Hand.home`, changed as the fault says. Raises: DeviceLost under ``off``."""
        return self._measured(self._device.home, moves=True)

    def stop(self) -> None:
        """Stop the wrapped hand at once under every fault; return late under ``slow``."""
        self._device.stop()
        self._tarry()

    def _measured(self, act: Callable[[], HandState], *, moves: bool = False) -> HandState:
        if moves and self._fault is Fault.STUCK:
            act = self._device.state
        state = self._unless_stuck(self._ask(act))
        if self._fault is Fault.GARBAGE:
            absurd = next(self._counter) % 2 == 1
            return state.model_copy(update={"width_m": ABSURD_WIDTH_M if absurd else math.nan})
        if self._fault is Fault.WRONG:
            return state.model_copy(update={"width_m": state.width_m + WRONG_WIDTH_M})
        return state


def faulty_devices(devices: Devices, settings: FaultSettings) -> tuple[Devices, dict[str, Spoilable]]:
    """Return the devices wrapped, each with its initial fault, and the wrappers by the name of their part."""
    camera, arm, hand = devices.camera, devices.arm, devices.hand
    delay_s = settings.delay_s
    wrapped = replace(
        devices,
        camera=FaultyCamera(camera, settings.camera, delay_s=delay_s) if camera is not None else None,
        arm=FaultyArm(arm, settings.arm, delay_s=delay_s) if arm is not None else None,
        hand=FaultyHand(hand, settings.hand, delay_s=delay_s) if hand is not None else None,
    )
    parts: dict[str, Spoilable] = {}
    for name in ("camera", "arm", "hand"):
        device = getattr(wrapped, name)
        if device is not None:
            parts[name] = device
    return wrapped, parts


def allow_faults(bus: Bus, parts: Mapping[str, Spoilable], settings: FaultSettings) -> None:
    """Answer ``fault/{part}`` for the devices of a node and for its own link, which gets its initial fault."""
    if isinstance(bus, FaultyBus):
        bus.delay_s, bus.fault = settings.delay_s, settings.bus
        parts = {**parts, "bus": bus}
    answer_faults(bus, parts, bus.publish)
