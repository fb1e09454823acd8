"""A frame with the pose it was taken from."""

from __future__ import annotations

from typing import Any, Self

from pydantic import ModelWrapValidatorHandler, model_validator

from bus.arrays import Joints, Transform
from bus.frozen import Message
from bus.messages.devices import ArmState, Frame
from bus.messages.frame_checks import bad, made, require_rigid


class View(Message):
    """The camera pose of one frame. The frame itself travels and is recorded as images, found by its stamp.

    A pose that is not rigid is a `bus.errors.BadFrame`.

    Attributes:
        stamp_ns: of the frame, UTC.
        arm: the arm's state at the capture; None of an image that was not taken by the cell.
        base_from_color: (4, 4) pose of the colour camera in ``base`` [m].
        why: why the arm looked again from here; "" for the first look.
    """

    stamp_ns: int
    arm: ArmState | None = None
    base_from_color: Transform
    why: str = ""

    @property
    def q_rad(self) -> Joints:
        """(joints,) positions at the capture. Raises: BadFrame of an image that was not taken by the cell."""
        if self.arm is None:
            raise bad("View.arm is missing: this image was not taken by the cell, so nobody knows where its arm was.")
        return self.arm.q_rad

    @model_validator(mode="wrap")
    @classmethod
    def _require_sound(cls, values: Any, make: ModelWrapValidatorHandler[Self]) -> Self:
        view = made("View", values, make)
        require_rigid("View.base_from_color", view.base_from_color)
        return view


class Observation(Message):
    """capture: the frame and its camera pose. ``view.stamp_ns == frame.stamp_ns``."""

    view: View
    frame: Frame

    def corrected(self, color_from_corrected: Transform) -> Observation:
        """Return the observation with the camera where ``base_from_color @ color_from_corrected`` (4, 4) puts it."""
        pose = self.view.base_from_color @ color_from_corrected
        return self.model_copy(update={"view": self.view.model_copy(update={"base_from_color": pose})})
