"""Checks an observation once more where it may have been changed after it was made; see `bus.messages.frame_checks`."""

from __future__ import annotations

from bus.codes import Code
from bus.errors import BadFrame, CycleFailure
from bus.messages import Frame, Observation, View


def checked(observation: Observation) -> Observation:
    """Make the observation anew: a copy with changed fields (``model_copy``) passed no check.

    Raises: CycleFailure(BAD_FRAME): a size, a unit, an intrinsic or a pose cannot be; the text names the field.
    """
    try:
        return Observation(view=View(**dict(observation.view)), frame=Frame(**dict(observation.frame)))
    except BadFrame as error:
        raise CycleFailure(Code.BAD_FRAME, error.text) from error
