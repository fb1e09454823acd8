"""The three protocols every driver implements: the simulated, the real and the remote one alike.

Life cycle: ``connect`` opens everything or nothing; ``close`` is always allowed and idempotent; every other
member raises `bus.errors.NotConnected` before ``connect`` and after ``close``. ``stop`` and ``hold`` never raise
and may be called from any thread, also while another call is under way. A ``stop`` ends every motion that was asked for
before it, also one that still waits to begin, which then never does. All errors are of `bus.errors.DriverError`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from bus.commands import Presented, PresentRequest
from bus.messages import ArmState, Frame, HandState, Motion
from bus.trajectory import Trajectory


@runtime_checkable
class Camera(Protocol):
    """An RGB-D camera."""

    def connect(self) -> None: ...

    def capture(self) -> Frame:
        """One fresh frame, exposed after the call. Raises: StaleFrame."""

    def close(self) -> None: ...


@runtime_checkable
class Arm(Protocol):
    """A seven-joint arm that plays sampled trajectories."""

    def connect(self) -> None: ...

    def state(self) -> ArmState: ...

    def execute(self, trajectory: Trajectory) -> Motion:
        """Play ``trajectory`` and return when the arm rests. Raises: MotionRefused (nothing moved), ArmReflex."""

    def stop(self) -> None:
        """Brake on the path, now. The running ``execute`` returns with ``finished = False``, also out of a hold."""

    def hold(self) -> None:
        """Brake on the path and wait there: the running ``execute`` goes on waiting, the mode stays MOVE.

        Without a motion nothing happens. Whoever holds confirms it by the measured velocity.
        """

    def resume(self) -> None:
        """Go on along the held path to its end. Raises: MotionRefused when nothing is held or about to be."""

    def recover(self) -> None:
        """Clear a reflex. Nothing moves."""

    def close(self) -> None: ...


@runtime_checkable
class Hand(Protocol):
    """A two-finger parallel hand."""

    def connect(self) -> None: ...

    def state(self) -> HandState: ...

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Open or close to ``width_m``, without force. Raises: HandFault."""

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Close until the fingers meet something (or each other), and keep pressing with ``force_n``."""

    def home(self) -> HandState:
        """Find the finger's zero once after power-on; ends open."""

    def stop(self) -> None:
        """Stop the fingers where they are; a grasp keeps its force (never drops what it holds)."""

    def close(self) -> None: ...


@runtime_checkable
class Reporting(Protocol):
    """What a device adds that has something to say about its own health."""

    def readings(self) -> dict[str, float]:
        """Figures by name, units in the names, e.g. ``ir_temperature_c``; empty while not connected. Never raises."""


@runtime_checkable
class ObjectPresenter(Protocol):
    """Simulation only: what puts objects on the table, and knows where they really are."""

    def present(self, request: PresentRequest) -> Presented:
        """Replace the object on the table. Raises: ConfigError for an unknown object."""

    def truth(self) -> Presented:
        """Name and true pose of the object now, and the names of those that could be presented."""


@dataclass(frozen=True)
class Devices:
    """What one driver brings; None = it does not serve that device."""

    camera: Camera | None = None
    arm: Arm | None = None
    hand: Hand | None = None
    presenter: ObjectPresenter | None = None
