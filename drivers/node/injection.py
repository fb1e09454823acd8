"""Devices that misbehave on demand: each wraps a Camera, Arm or Hand, so that one can see what the cell does about it.

The fault may be changed at any time, from any thread (``arm.fault = Fault.OFF``). ``off``: everything but ``close``,
``stop`` and ``hold`` raises `bus.errors.DeviceLost`, and a moving arm brakes. ``stuck``: it says again what it said
last, stamp included, and carries nothing out. ``slow``: each answer comes ``delay_s`` late. ``stop``, ``hold`` and
``close`` reach the wrapped device at once whatever the fault: an injected fault never keeps a stop from a real arm.
``wrong`` moves the arm elsewhere than planned: for simulators, and for an arm with nothing in its reach.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from bus.errors import DeviceLost
from bus.injected import Spoilable
from bus.injection import Fault, Faulty
from bus.messages import ArmState, Frame, HandState, Motion
from bus.trajectory import Trajectory
from config.injection import FaultSettings
from drivers.interface import Arm, Camera, Devices, Hand, Reporting
from drivers.motion.stops import Stops
from drivers.motion.unmoved import unmoved

WRONG_JOINT_RAD = 0.1
"""Added to every joint: encoders that lost their zero."""
WRONG_WIDTH_M = 0.01
ABSURD_WIDTH_M = 5.0

DeviceT = TypeVar("DeviceT", Camera, Arm, Hand)
SaidT = TypeVar("SaidT", Frame, ArmState, HandState)
AnswerT = TypeVar("AnswerT")


class _Device(Faulty, Generic[DeviceT, SaidT]):
    """What the three share.

    Args:
        device: what is wrapped; not yet connected.
        delay_s: how late a slow one answers.
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
        self._ask(self._device.connect)

    def close(self) -> None:
        self._device.close()
        with self._turn:
            self._last = None

    def readings(self) -> dict[str, float]:
        """Those of the wrapped device, if it has any; a lost one has none."""
        if self._fault is Fault.OFF or not isinstance(self._device, Reporting):
            return {}
        return self._device.readings()

    def _lose_power(self) -> None:
        """What a device does by itself when it goes off."""

    def _ask(self, act: Callable[[], AnswerT]) -> AnswerT:
        """What the wrapped device answers: late if slow, and never if it is off before or after."""
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
        """``said``, or what was said last when it was stuck since."""
        with self._turn:
            if self._last is None or self._fault is not Fault.STUCK:
                self._last = said
            return self._last


class FaultyCamera(_Device[Camera, Frame]):
    """``garbage``: in turns a black image with zero depth, and noise with none. ``wrong``: a mirrored colour image."""

    def capture(self) -> Frame:
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
    """``garbage``: NaN in every joint. ``wrong``: `WRONG_JOINT_RAD` in what it says and in what it is told.

    ``stuck``: ``execute`` moves nothing and returns only after a ``stop``, a ``close`` or another fault.
    """

    def __init__(self, device: Arm, fault: Fault = Fault.NONE, *, delay_s: float = 1.0) -> None:
        super().__init__(device, fault, delay_s=delay_s)
        self._stops = Stops()

    def state(self) -> ArmState:
        state = self._unless_stuck(self._ask(self._device.state))
        if self._fault is Fault.GARBAGE:
            none = np.full(7, np.nan)
            return state.model_copy(update={"q_rad": none, "dq_rad_s": none, "tau_ext_nm": none})
        if self._fault is Fault.WRONG:
            return state.model_copy(update={"q_rad": state.q_rad + WRONG_JOINT_RAD})
        return state

    def execute(self, trajectory: Trajectory) -> Motion:
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
        self._stop_all()
        self._tarry()

    def hold(self) -> None:
        self._device.hold()
        self._tarry()

    def resume(self) -> None:
        self._ask(self._device.resume)

    def recover(self) -> None:
        self._ask(self._device.recover)

    def close(self) -> None:
        super().close()
        self._stop_all()

    def _lose_power(self) -> None:
        self._stop_all()


def _turned(motion: Motion) -> Motion:
    """As the arm sees it that believes in its wrong zero."""
    believed = {name: getattr(motion, name) + WRONG_JOINT_RAD for name in ("commanded_q_rad", "q_rad")}
    return motion.model_copy(update=believed)


def _unreadable(motion: Motion) -> Motion:
    measured = ("q_rad", "dq_rad_s", "tau_ext_nm")
    return motion.model_copy(update={name: np.full_like(getattr(motion, name), np.nan) for name in measured})


class FaultyHand(_Device[Hand, HandState]):
    """``garbage``: in turns a width of NaN and of `ABSURD_WIDTH_M`. ``wrong``: `WRONG_WIDTH_M` too wide."""

    def state(self) -> HandState:
        return self._measured(self._device.state)

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        return self._measured(lambda: self._device.move(width_m, speed_m_s), moves=True)

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        return self._measured(lambda: self._device.grasp(force_n, speed_m_s), moves=True)

    def home(self) -> HandState:
        return self._measured(self._device.home, moves=True)

    def stop(self) -> None:
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
    """The devices wrapped, each with its initial fault; and those wrappers by the name of their part."""
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
