"""Fault injection for goal-image models: a wrapper that misbehaves on demand. Its replies are recorded as given."""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.fault_injection import Fault
from bus.faulty_bus import Faulty
from perception.geometry.window import Window, encode_png
from perception.models.base import GoalImageModel
from perception.observed_object import Answer, ObservedObject

_LOOK_S = 0.05
_PICTURE_PX = 512
_NO_PICTURE = b"\x89PNG" + bytes(range(64))


class FaultyModel(Faulty):
    """A goal-image model with an injected fault.

    ``off``: refuses the connection. ``stuck``: gives no answer within ``deadline_s``. ``slow``: answers ``delay_s``
    late.
    ``garbage``: its picture is not decodable. ``wrong``: its picture shows another object.
    """

    def __init__(
        self, model: GoalImageModel, fault: Fault = Fault.NONE, *, deadline_s: float, delay_s: float = 1.0
    ) -> None:
        super().__init__(fault, delay_s)
        self._model, self._deadline_s = model, deadline_s
        self.name, self.is_hosted = model.name, model.is_hosted

    def begin(self) -> None:
        """Begin a cycle of the wrapped model."""
        self._model.begin()

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        """As the wrapped model, with the injected fault. ``color``: (H, W, 3)."""
        return self._ask(lambda: self._model.locate(color, prompt, cancel), cancel)

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """As the wrapped model, with the injected fault."""
        return self._ask(lambda: self._model.reason(observed_object, prompt, cancel), cancel)

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """As the wrapped model, with the injected fault."""
        return self._ask(lambda: self._model.direct(observed_object, prompt, cancel), cancel)

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """As the wrapped model, with the injected fault."""
        answer = self._ask(lambda: self._model.render(observed_object, prompt, cancel), cancel)
        if self._fault is Fault.GARBAGE:
            return Answer(answer.text, image_png=_NO_PICTURE)
        return Answer(answer.text, image_png=_another(observed_object)) if self._fault is Fault.WRONG else answer

    def close(self) -> None:
        """Remove the fault and close the wrapped model."""
        self.fault = Fault.NONE
        self._model.close()

    def _ask(self, ask: Callable[[], Answer], cancel: Cancel) -> Answer:
        """Raises: CycleFailure(MODEL_UNAVAILABLE, MODEL_TIMEOUT, STOPPED), or what the model raises."""
        if self._fault is Fault.OFF:
            raise CycleFailure(Code.MODEL_UNAVAILABLE, f"{self.name}: connection refused (injected fault).")
        answer = ask()
        with self._turn:
            if self._fault is Fault.SLOW:
                self._wait_for(lambda: self._fault is not Fault.SLOW, self.delay_s, cancel)
            if not self._wait_for(lambda: self._fault is not Fault.STUCK, self._deadline_s, cancel):
                text = f"{self.name}: no answer within {self._deadline_s:.1f} s (injected fault)."
                raise CycleFailure(Code.MODEL_TIMEOUT, text)
        return answer

    def _wait_for(self, is_over: Callable[[], bool], timeout_s: float, cancel: Cancel) -> bool:
        """True when ``is_over`` holds within ``timeout_s``; called with `_turn` held. Raises: CycleFailure(STOPPED)."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0:
            if self._turn.wait_for(is_over, min(left_s, _LOOK_S)):
                return True
            cancel.raise_if_set("detect")
        return is_over()


def _another(observed_object: ObservedObject) -> bytes:
    """A disc of a colour that the object does not have, with a rod through it, at the object's place."""
    window = Window.around(observed_object.mask)
    picture = np.full((_PICTURE_PX, _PICTURE_PX, 3), observed_object.background, dtype=np.uint8)
    middle, radius = _PICTURE_PX // 2, _PICTURE_PX // 4
    median = np.median(observed_object.rgbd.color[observed_object.mask], axis=0)
    cv2.circle(picture, (middle, middle), radius, tuple(255 - int(value) for value in median), -1)
    cv2.line(picture, (middle // 4, middle), (_PICTURE_PX - middle // 4, middle), observed_object.rod.rgb, 12)
    return encode_png(picture, max(_PICTURE_PX, window.side_px))
