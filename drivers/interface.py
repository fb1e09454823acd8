"""The protocols that every driver implements: simulated, real and remote. Frames, units and signs: docs/frames.md.

Life cycle: ``connect`` opens everything or nothing; ``close`` is always allowed and idempotent; every other
member raises `bus.errors.NotConnected` before ``connect`` and after ``close``. ``stop`` and ``hold`` never raise
and may be called from any thread, also while another call runs. A ``stop`` ends every motion that was requested
before it; one that still waits to begin never begins. All errors are of `bus.errors.DriverError`.
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

    def connect(self) -> None:
        """Open the camera. Raises: DriverUnavailable."""

    def capture(self) -> Frame:
        """Return one fresh frame, exposed after the call. Raises: StaleFrame, DeviceLost, BadFrame (by making it)."""

    def close(self) -> None:
        """Close the camera; idempotent."""


@runtime_checkable
class Arm(Protocol):
    """An arm that plays sampled trajectories."""

    def connect(self) -> None:
        """Open the arm. Raises: DriverUnavailable."""

    def state(self) -> ArmState:
        """Return the measured state. Raises: DeviceLost."""

    def execute(self, trajectory: Trajectory) -> Motion:
        """Play ``trajectory`` and return when the arm rests; where it waits (``waits_at``) it is held until `resume`.

        On its guarded part (``guard``) the arm brakes on its path by itself, within milliseconds, when it meets
        something: then ``Motion.contact_n`` is the force. While it is held it feels nothing.

        Raises:
            MotionRefused: nothing moved.
            ArmReflex: the arm stopped itself.
            DeviceLost: the arm no longer answers.
        """

    def stop(self) -> None:
        """Brake on the path, now. The running ``execute`` returns with ``finished = False``, also out of a hold."""

    def hold(self) -> None:
        """Brake on the path and wait there: the running ``execute`` does not return, the mode stays MOVE.

        Without a motion nothing happens. The caller confirms the hold by the measured velocity.
        """

    def resume(self) -> None:
        """Continue along the held path to its end, also past where the trajectory waits.

        Raises: MotionRefused when no motion is held or about to be.
        """

    def recover(self) -> None:
        """Clear a reflex. Nothing moves. Raises: MotionRefused when the operator has to act first."""

    def close(self) -> None:
        """Stop the arm and close it; idempotent."""


@runtime_checkable
class Hand(Protocol):
    """A two-finger parallel hand."""

    def connect(self) -> None:
        """Open the hand. Raises: DriverUnavailable."""

    def state(self) -> HandState:
        """Return the measured state. Raises: DeviceLost."""

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """Open or close to ``width_m`` without force control, at the width's rate ``speed_m_s``. Raises: HandFault."""

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """Close until the fingers meet an object (or each other), and keep pressing.

        Args:
            force_n: grasping force.
            speed_m_s: rate of the width.

        Raises: HandFault.
        """

    def home(self) -> HandState:
        """Find the fingers' zero once after power-on; the hand ends open. Raises: HandFault."""

    def stop(self) -> None:
        """Stop the fingers where they are; a grasp keeps its force and so the object."""

    def close(self) -> None:
        """Close the connection; idempotent."""


@runtime_checkable
class Reporting(Protocol):
    """Addition of a device that reports its own health."""

    def readings(self) -> dict[str, float]:
        """Return figures by name, units in the names, e.g. ``ir_temperature_c``; empty while not connected.

        Never raises.
        """


@runtime_checkable
class ObjectPresenter(Protocol):
    """Simulation only: puts objects on the table, and knows their true poses."""

    def present(self, request: PresentRequest) -> Presented:
        """Replace the object on the table. Raises: ConfigError for an unknown object."""

    def truth(self) -> Presented:
        """Return name and true pose of every object now, and the names of those that can be presented."""


@dataclass(frozen=True)
class Devices:
    """The devices of one driver; None = it does not serve that device."""

    camera: Camera | None = None
    arm: Arm | None = None
    hand: Hand | None = None
    presenter: ObjectPresenter | None = None
