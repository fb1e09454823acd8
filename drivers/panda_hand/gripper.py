"""One connection to a Franka hand over franky: the only file that touches that package; maps its errors to ours."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from bus.errors import DeviceAbsent, DeviceLost, DriverUnavailable, HandFault

LOST_ADVICE = "Check the arm's power and network; when it is back, `cell clear` and `cell reset`."


def load_franky() -> Any:
    """Import the package. Raises: ImportError."""
    return importlib.import_module("franky")


class Gripper:
    """A connected hand; speeds are those of one finger [m/s]. Every call raises: HandFault, DeviceLost.

    Args:
        address: of the robot's control box.
        load: imports the package.

    Raises:
        DriverUnavailable: no package, or no hand at that address.
    """

    def __init__(self, address: str, load: Callable[[], Any]) -> None:
        try:
            self._franky = load()
        except ImportError as error:
            raise DriverUnavailable(
                f"franky cannot be imported: {error}.", "uv pip install 'vlad-cell[fr3]'"
            ) from error
        try:
            self._hand = self._franky.Gripper(address)
        except (self._franky.Exception, RuntimeError) as error:
            raise DeviceAbsent(
                f"The Franka hand at {address} cannot be reached: {' '.join(str(error).split())}.",
                "Check power and panda_hand.address; in Desk the End Effector must be the Franka Hand, and FCI active.",
            ) from error

    def widths_m(self) -> tuple[float, float]:
        """Return the width now and the widest one (0 before homing). Raises: HandFault if not finite; DeviceLost."""
        with self._mapped():
            now = self._hand.state
        width_m, widest_m = _number(now, "width"), _number(now, "max_width")
        if not (math.isfinite(width_m) and math.isfinite(widest_m)):
            raise HandFault(f"The hand said what is no width: {width_m}, of {widest_m}.", "Home it again.")
        return width_m, widest_m

    def homing(self) -> bool:
        """Home the hand; return whether it succeeded."""
        with self._mapped():
            return bool(self._hand.homing())

    def move(self, width_m: float, finger_m_s: float) -> bool:
        """Move to ``width_m`` at ``finger_m_s`` of one finger; return whether it succeeded."""
        with self._mapped():
            return bool(self._hand.move(width_m, finger_m_s))

    def grasp(self, finger_m_s: float, force_n: float, widest_m: float) -> bool:
        """Close on any object with ``force_n``; return whether it succeeded.

        Every final width up to ``widest_m`` counts as grasped, so that the force is kept.

        Args:
            finger_m_s: speed of one finger.
        """
        with self._mapped():
            return bool(self._hand.grasp(0.0, finger_m_s, force_n, widest_m, widest_m))

    def stop(self) -> None:
        """Stop the fingers; this releases a grasped object."""
        with self._mapped():
            self._hand.stop()

    @contextmanager
    def _mapped(self) -> Iterator[None]:
        """Map libfranka's errors to ours."""
        try:
            yield
        except (self._franky.NetworkException, RuntimeError) as error:  # a lost one may be a RuntimeError
            raise DeviceLost(f"The hand was lost: {' '.join(str(error).split())}.", LOST_ADVICE) from error
        except self._franky.Exception as error:
            said = " ".join(str(error).replace("libfranka gripper:", "").split())
            raise HandFault(f"The hand refused: {said}", "Home it again with `cell reset`.") from error


def _number(state: Any, name: str) -> float:
    """Return the field as a float; NaN when it is missing or no number."""
    try:
        return float(getattr(state, name, math.nan))
    except (TypeError, ValueError):
        return math.nan
