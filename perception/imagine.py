"""Stage 1 of the paper, *imagine*: reason -> direct -> render, every reply recorded."""

from __future__ import annotations

import cv2
import numpy as np

from bus.messages import ModelReply
from config.schema import Station
from perception.models.base import GoalImage, GoalImageModel, RodColor, Subject
from perception.prompts import prompt
from perception.segment import hue_of

BACKGROUND = 255
ROD_COLORS = (
    RodColor("magenta", (255, 0, 200)),
    RodColor("cyan", (0, 220, 255)),
    RodColor("lime green", (90, 255, 0)),
    RodColor("yellow", (255, 230, 0)),
)
_HUE_APART = 14


def imagine(model: GoalImageModel, subject: Subject, station: Station) -> tuple[GoalImage, tuple[ModelReply, ...]]:
    """The goal image and what was said on the way to it (Algorithm 1, lines 2-5). Raises: as the model."""
    ask_reason = prompt(
        "reason",
        max_width_mm=f"{station.hand.max_width_m * 1e3:.0f}",
        finger_width_mm=f"{station.hand.finger_width_m * 1e3:.0f}",
    )
    reasoning = model.reason(subject, ask_reason)
    ask_direct = prompt("direct", reasoning=reasoning)
    directive = model.direct(reasoning, ask_direct)
    constraint = prompt(
        "constraint",
        rod_color=subject.rod.name,
        rod_diameter_mm=f"{2e3 * station.perception.rod_radius_m:.0f}",
    )
    goal = model.render(subject, directive, constraint)
    replies = (
        ModelReply(step="reason", model=model.name, prompt=ask_reason, reply=reasoning),
        ModelReply(step="direct", model=model.name, prompt=ask_direct, reply=directive),
        ModelReply(step="render", model=model.name, prompt=constraint, reply=f"image {goal.image.shape}"),
    )
    return goal, replies


def masked(color: np.ndarray, object_mask: np.ndarray) -> np.ndarray:
    """The object alone on a plain background (I_S)."""
    return np.where(object_mask[..., None], color, np.uint8(BACKGROUND))


def free_rod_color(color: np.ndarray, around: np.ndarray) -> RodColor:
    """The rod colour whose hue the fewest saturated pixels of ``around`` have; the first of equals."""
    hsv = cv2.cvtColor(np.ascontiguousarray(color[around][:, None]), cv2.COLOR_RGB2HSV)[:, 0].astype(int)
    vivid = hsv[hsv[:, 1] > 80][:, 0]

    def taken(candidate: RodColor) -> int:
        apart = np.abs(vivid - hue_of(candidate.rgb))
        return int((np.minimum(apart, 180 - apart) < _HUE_APART).sum())

    return min(ROD_COLORS, key=taken)
