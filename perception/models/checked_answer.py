"""Checks of a goal-image model's answers at the door: each refusal says what was given and what was due."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.messages import Usage
from perception.models.plug_in_calls import Rules
from perception.observed_object import Answer, GoalImage, ObservedObject, PaintedRod


def checked_words(rules: Rules, step: str, given: object) -> Answer:
    """Return the answer to ``locate``, ``reason`` or ``direct``. Raises: CycleFailure, as the rules say."""
    if not isinstance(given, Answer):
        raise rules.refused(f"gave {type(given).__name__} in {step}, and no Answer")
    for field, kind in (("text", str), ("image_png", bytes | None), ("usage", Usage), ("attempts", int)):
        _require_kind(rules, f"Answer.{field}", getattr(given, field), kind)
    return given


def checked_picture(rules: Rules, given: object, observed_object: ObservedObject) -> Answer:
    """Return the answer to ``render``; depth as float32. Raises: CycleFailure, as the rules say."""
    answer = checked_words(rules, "render", given)
    goal = answer.goal
    if goal is None:
        return answer
    _require_kind(rules, "Answer.goal", goal, GoalImage)
    _require_kind(rules, "GoalImage.painted", goal.painted, PaintedRod | None)
    shape = observed_object.mask.shape
    _require_array(rules, "GoalImage.image", goal.image, (*shape, 3), np.uint8)
    if goal.painted is not None:
        _check_painted(rules, goal.painted, shape)
    if goal.depth_m is None:
        return answer
    _require_array(rules, "GoalImage.depth_m", goal.depth_m, shape, np.floating)
    return replace(answer, goal=replace(goal, depth_m=goal.depth_m.astype(np.float32, copy=False)))


def _check_painted(rules: Rules, painted: PaintedRod, shape: tuple[int, ...]) -> None:
    _require_array(rules, "PaintedRod.rod", painted.rod, shape, np.bool_)
    _require_array(rules, "PaintedRod.object", painted.object, shape, np.bool_)
    if painted.run is not None:
        _require_numbers(rules, "PaintedRod.run", painted.run, (2, 3))
        if painted.run[:, 2].min() <= 0 or not (painted.run[0] != painted.run[1]).any():
            raise rules.refused("gave PaintedRod.run that is no line in front of the camera")
    if painted.approach_base is not None:
        _require_numbers(rules, "PaintedRod.approach_base", painted.approach_base, (3,))
        if abs(float(np.linalg.norm(painted.approach_base)) - 1) > 1e-3:
            raise rules.refused("gave PaintedRod.approach_base that is not of length 1")


def _require_kind(rules: Rules, field: str, value: object, kind: Any) -> None:
    if not isinstance(value, kind):
        raise rules.refused(f"gave {field} = {type(value).__name__}, and it is {getattr(kind, '__name__', kind)}")


def _require_array(rules: Rules, field: str, value: object, shape: tuple[int, ...], kind: type[np.generic]) -> None:
    if not isinstance(value, np.ndarray):
        raise rules.refused(f"gave {field} = {type(value).__name__}, and it is {shape} of {kind.__name__}")
    if value.shape != shape or not np.issubdtype(value.dtype, kind):
        raise rules.refused(f"gave {field} = {value.shape} of {value.dtype}, and it is {shape} of {kind.__name__}")


def _require_numbers(rules: Rules, field: str, value: npt.NDArray[np.float64], shape: tuple[int, ...]) -> None:
    _require_array(rules, field, value, shape, np.floating)
    if not np.isfinite(value).all():
        raise rules.refused(f"gave {field} that is not of finite numbers")
