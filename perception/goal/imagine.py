"""Stage 1 of the paper, *imagine*: reason -> direct -> render. Every call is reported as it ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Instance, ModelReply
from config.schema import Station
from perception.geometry.color import hue_of
from perception.geometry.crop import Crop, Mask
from perception.geometry.window import Window, decode_picture
from perception.goal.prompts import prompt
from perception.models.base import GoalImageModel
from perception.observed_object import Answer, Axis, GoalImage, ObservedObject, RodColor
from perception.scene.scene import Scene

ROD_COLORS = (
    RodColor("magenta", (255, 0, 200)),
    RodColor("cyan", (0, 220, 255)),
    RodColor("lime green", (90, 255, 0)),
    RodColor("yellow", (255, 230, 0)),
)
BACKGROUNDS = {
    (255, 255, 255): "white",
    (128, 128, 128): "grey",
    (0, 0, 0): "black",
    (130, 175, 255): "sky blue",
    (20, 70, 60): "dark green",
}
_HUE_APART = 14
_MARGIN_M = 0.06
_NEAR_BACKGROUND = 48

Step = Literal["begin", "locate", "reason", "direct", "render"]
OnReply = Callable[[ModelReply], None]


@dataclass(frozen=True)
class Conversation:
    """The calls of one proposal to the model; each is reported, successful or not.

    Attributes:
        on_reply: called with the record of each call. ``sample``: number of the proposal, from 0.
        clock_s: monotonic clock [s]. ``cancel``: a stop request; after it no call begins.
    """

    model: GoalImageModel
    on_reply: OnReply
    sample: int = 0
    clock_s: Callable[[], float] = time.monotonic
    cancel: Cancel = field(default_factory=Cancel)

    def begin(self) -> None:
        """Begin a cycle of the model; only a failure is reported. Raises: CycleFailure, as the model."""
        began_s = self.clock_s()
        try:
            self.model.begin()
        except CycleFailure as failure:
            self._report_failure("begin", "", failure, began_s)
            raise

    def ask(self, step: Step, text: str, call: Callable[[], Answer]) -> Answer:
        """Make one call and report it.

        Raises: CycleFailure, as the model; STOPPED after a stop. A call that a stop cut off is reported, too.
        """
        self.cancel.raise_if_set("detect")
        began_s = self.clock_s()
        try:
            answer = call()
        except CycleFailure as failure:
            self._report_failure(step, text, failure, began_s)
            raise
        what = {"text": answer.text, "image_png": answer.image_png, "usage": answer.usage, "attempts": answer.attempts}
        self._report(step, text, what, began_s)
        return answer

    def _report_failure(self, step: Step, text: str, failure: CycleFailure, began_s: float) -> None:
        self._report(step, text, {"failure": failure.failure, "text_of_failure": failure.text}, began_s)

    def _report(self, step: Step, text: str, what: Mapping[str, Any], began_s: float) -> None:
        heard = {"step": step, "sample": self.sample, "model": self.model.name, "prompt": text}
        self.on_reply(ModelReply.model_validate({**heard, **what, "latency_s": self.clock_s() - began_s}))


def observed_object_of(
    scene: Scene,
    instances: tuple[Instance, ...],
    number: int,
    outline: Mask,
    axes: tuple[Axis, ...] = (),
    margin_px: int | None = None,
) -> tuple[ObservedObject, Crop]:
    """Return the model's input: the object alone on a plain background, and the colour its rod must have; and its crop.

    Args:
        instances: the things of the scene. ``number``: of the object.
        outline: (H, W) of the object in the colour image.
        axes: along which the jaw could close on it.
        margin_px: around the object; None = enough for a rod that sticks out.
    """
    rgbd = scene.rgbd
    crop = Crop.around(outline, _margin_px(scene, outline) if margin_px is None else margin_px)
    part, mask = crop.rgbd(rgbd), crop.of(outline)
    background = free_background(part.color[mask])
    masked = np.where(mask[..., None], part.color, np.array(background, dtype=np.uint8))
    observed_object = ObservedObject(
        scene=scene,
        instances=instances,
        instance=instances[number - 1],
        rgbd=part,
        mask=mask,
        height_m=crop.of(scene.height_m),
        masked=masked,
        background=background,
        base_from_color=scene.base_from_color,
        rod=free_rod_color(part.color[mask]),
        axes=axes,
    )
    return observed_object, crop


def _margin_px(scene: Scene, outline: Mask) -> int:
    """Margin around the object [px] that contains a rod which sticks out."""
    nearest_m = float(np.nanmin(scene.rgbd.depth_m[outline]))
    return int(np.ceil(_MARGIN_M * scene.rgbd.camera.fx / nearest_m))


def imagine(talk: Conversation, observed_object: ObservedObject, station: Station) -> GoalImage:
    """Return the goal image (Algorithm 1, lines 2-5).

    Raises: CycleFailure, as the model; MODEL_BAD_IMAGE, MODEL_NO_IMAGE.
    """
    model, jaw_mm, scale = talk.model, f"{station.hand.max_width_m * 1e3:.0f}", _px_per_mm(observed_object, station)
    if station.perception.imagine.steps == 3:
        finger_mm = f"{station.hand.finger_width_m * 1e3:.0f}"
        ask_reason = prompt("reason", max_width_mm=jaw_mm, finger_width_mm=finger_mm, px_per_mm=scale)
        reasoning = talk.ask("reason", ask_reason, lambda: model.reason(observed_object, ask_reason, talk.cancel)).text
        ask_direct = prompt("direct", reasoning=reasoning)
        directive = talk.ask("direct", ask_direct, lambda: model.direct(observed_object, ask_direct, talk.cancel)).text
    else:
        directive = prompt("render", max_width_mm=jaw_mm)
    ask_render = prompt(
        "constraint",
        directive=directive,
        rod_color=observed_object.rod.name,
        rod_diameter_mm=f"{2e3 * station.perception.rod_radius_m:.0f}",
        px_per_mm=scale,
        background=BACKGROUNDS[observed_object.background],
    )
    return _goal(
        talk.ask("render", ask_render, lambda: model.render(observed_object, ask_render, talk.cancel)), observed_object
    )


def _px_per_mm(observed_object: ObservedObject, station: Station) -> str:
    """The scale [px/mm], at the object's depth, of the picture that a hosted model is shown."""
    mask, camera = observed_object.mask, observed_object.rgbd.camera
    enlarged = station.perception.hosted.size_px / Window.around(mask).side_px
    return f"{enlarged * camera.fx / float(np.nanmedian(observed_object.rgbd.depth_m[mask])) / 1e3:.2f}"


def _goal(answer: Answer, observed_object: ObservedObject) -> GoalImage:
    if answer.goal is not None:
        return answer.goal
    if answer.image_png is None:
        raise CycleFailure(Code.MODEL_NO_IMAGE, f"The model drew nothing, but said: {answer.text[:200]}")
    window = Window.around(observed_object.mask)
    plain = np.full_like(observed_object.masked, np.array(observed_object.background, dtype=np.uint8))
    return GoalImage(window.paste(decode_picture(answer.image_png, window, observed_object.background), plain), None)


def free_rod_color(around: npt.NDArray[np.uint8]) -> RodColor:
    """Return the rod colour whose hue the fewest saturated pixels of ``around`` (n, 3) share; of equals the first."""
    hsv = cv2.cvtColor(np.ascontiguousarray(around[:, None]), cv2.COLOR_RGB2HSV)[:, 0].astype(int)
    vivid = hsv[hsv[:, 1] > 80][:, 0]

    def taken(candidate: RodColor) -> int:
        apart = np.abs(vivid - hue_of(candidate.rgb))
        return int((np.minimum(apart, 180 - apart) < _HUE_APART).sum())

    return min(ROD_COLORS, key=taken)


def free_background(object_rgb: npt.NDArray[np.uint8]) -> tuple[int, int, int]:
    """Return the background colour that is close to the fewest of the object's pixels (n, 3); of equals the first."""

    def taken(rgb: tuple[int, int, int]) -> int:
        low, high = (np.array(rgb) + sign * (_NEAR_BACKGROUND - 1) for sign in (-1, 1))
        return cv2.countNonZero(cv2.inRange(object_rgb[:, None], low, high))

    return min(BACKGROUNDS, key=taken)
