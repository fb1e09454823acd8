"""Devices of another package's driver: what one raises that is no error of a device is named as its own."""

from __future__ import annotations

import logging
from collections.abc import Callable
from types import NoneType, SimpleNamespace
from typing import Any, TypeVar, cast, get_type_hints

from bus.errors import DeviceLost, DriverError, DriverUnavailable
from bus.redaction import raised
from drivers.interface import Arm, Camera, Devices, Hand, Reporting

_log = logging.getLogger(__name__)
DeviceT = TypeVar("DeviceT", Camera, Arm, Hand)
_ADVICE = (
    "Correct that driver, or ask who made it: where it failed stands in the log of its node. Then `cell clear` and"
    " `cell reset`."
)


def named(devices: Devices, driver: str, package: str) -> Devices:
    """Return the devices, whose errors name them.

    Args:
        driver: its name in the station file. ``package``: that brings it, with its version.

    Raises: DriverUnavailable when a device lacks a member of its protocol.
    """
    of = f"of driver {driver!r} of package {package}"
    return Devices(
        camera=None if devices.camera is None else _named(devices.camera, Camera, f"The camera {of}"),
        arm=None if devices.arm is None else _named(devices.arm, Arm, f"The arm {of}"),
        hand=None if devices.hand is None else _named(devices.hand, Hand, f"The hand {of}"),
        presenter=devices.presenter,
    )


def _named(device: DeviceT, kind: type, whose: str) -> DeviceT:
    said: list[str] = []
    members: dict[str, Callable[..., Any]] = {}
    for name in (member for member in vars(kind) if not member.startswith("_")):
        if not callable(member := getattr(device, name, None)):
            raise DriverUnavailable(f"{whose} has no {name!r}.", "See docs/extend.md, A driver.")
        gives = get_type_hints(getattr(kind, name))["return"]
        members[name] = _guarded(_checked(member, name, gives), whose, said)
    if isinstance(device, Reporting):
        members["readings"] = _readings(_guarded(device.readings, whose, said))
    return cast(DeviceT, SimpleNamespace(**members))


def _checked(member: Callable[..., Any], name: str, gives: type) -> Callable[..., Any]:
    """The member; what it returns is of the type that its protocol says."""

    def call(*args: Any, **named_args: Any) -> Any:
        given = member(*args, **named_args)
        if gives is not NoneType and not isinstance(given, gives):
            raise TypeError(f"{name}() returned {type(given).__name__}, and it returns {gives.__name__}")
        return given

    return call


def _guarded(member: Callable[..., Any], whose: str, said: list[str]) -> Callable[..., Any]:
    """The member; what it raises beside errors of devices, `SystemExit` too, is a DeviceLost that names its device.

    Args:
        said: what was logged of this device last; a state that is asked for 20 times a second fails as often.
    """

    def call(*args: Any, **named_args: Any) -> Any:
        try:
            return member(*args, **named_args)
        except DriverError:
            raise
        except (Exception, SystemExit) as error:
            text = f"{whose} failed: {raised(error)}."
            if said != [text]:
                said[:] = [text]
                _log.warning("%s", text, exc_info=True)
            raise DeviceLost(text, _ADVICE) from error

    return call


def _readings(member: Callable[[], dict[str, float]]) -> Callable[[], dict[str, float]]:
    """Readings never raise: none where they fail."""

    def call() -> dict[str, float]:
        try:
            return member()
        except DriverError:
            return {}

    return call
