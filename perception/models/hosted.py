"""Every hosted model: one deadline, bounded retries, a purse, the window it is shown. Providers differ in calls."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Usage
from config.schema import HostedSettings, PriceSettings
from perception.models.base import Answer, Subject
from perception.models.purse import Purse
from perception.models.window import Window, encode_png


class ModelFault(Exception):
    """A provider gave no usable answer.

    Attributes:
        code: what kind. ``again``: asking again may help. ``after_s``: not before that, says the server.
    """

    def __init__(self, code: Code, text: str, *, again: bool = False, after_s: float = 0.0) -> None:
        super().__init__(text)
        self.code, self.text, self.again, self.after_s = code, text, again, after_s


class Provider(Protocol):
    """One provider's API. Each call keeps within ``timeout_s`` and raises ModelFault for every failure."""

    name: str

    def say(self, prompt: str, image_png: bytes | None, timeout_s: float) -> Answer:
        """Words."""

    def edit(self, image_png: bytes, keep_png: bytes, prompt: str, timeout_s: float) -> Answer:
        """The image redrawn. ``keep_png``: RGBA of the image's size, opaque where it must stay as it is."""

    def close(self) -> None:
        """Let go of connections."""


class HostedModel:
    """A goal-image model behind a provider's API."""

    def __init__(
        self,
        provider: Provider,
        settings: HostedSettings,
        purse: Purse,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.name = provider.name
        self._provider, self._settings, self._purse = provider, settings, purse
        self._clock, self._sleep = clock, sleep

    def begin(self) -> None:
        self._purse.begin()

    def locate(self, color: npt.NDArray[np.uint8], prompt: str) -> Answer:
        side = max(color.shape[:2])
        png = encode_png(Window(0, 0, side).cut(color, 0), self._settings.size_px)
        return self._call(lambda timeout_s: self._provider.say(prompt, png, timeout_s))

    def reason(self, subject: Subject, prompt: str) -> Answer:
        png = self._shown(subject)
        return self._call(lambda timeout_s: self._provider.say(prompt, png, timeout_s))

    def direct(self, subject: Subject, prompt: str) -> Answer:
        return self._call(lambda timeout_s: self._provider.say(prompt, None, timeout_s))

    def render(self, subject: Subject, prompt: str) -> Answer:
        window = Window.around(subject.scene.object_mask)
        kept = window.cut(subject.scene.object_mask.astype(np.uint8) * 255, 0)
        keep_png = encode_png(np.dstack([kept, kept, kept, kept]), self._settings.size_px)
        png = self._shown(subject)
        return self._call(lambda timeout_s: self._provider.edit(png, keep_png, prompt, timeout_s))

    def close(self) -> None:
        self._provider.close()

    def _shown(self, subject: Subject) -> bytes:
        window = Window.around(subject.scene.object_mask)
        return encode_png(window.cut(subject.masked, subject.background), self._settings.size_px)

    def _call(self, ask: Callable[[float], Answer]) -> Answer:
        """Ask until there is an answer, the attempts are used up, or the deadline is too near."""
        self._purse.require()
        settings, deadline_s = self._settings, self._clock() + self._settings.deadline_s
        for attempt in range(1, settings.attempts + 1):
            try:
                answer = ask(deadline_s - self._clock())
            except ModelFault as fault:
                wait_s = max(settings.backoff_s * 2 ** (attempt - 1), fault.after_s)
                if not fault.again or attempt == settings.attempts or self._clock() + wait_s >= deadline_s:
                    asked = f" Asked {attempt} times." if attempt > 1 else ""
                    raise CycleFailure(fault.code, f"{self.name}: {fault.text}{asked}") from fault
                self._sleep(wait_s)
                continue
            cost_usd = _cost_usd(answer, settings.price)
            self._purse.pay(self.name, cost_usd)
            return replace(answer, attempts=attempt, usage=answer.usage.model_copy(update={"cost_usd": cost_usd}))
        raise AssertionError("at least one attempt is made")


def _cost_usd(answer: Answer, price: PriceSettings) -> float:
    usage: Usage = answer.usage
    tokens = (
        usage.input_tokens * price.usd_per_million_input_tokens
        + usage.output_tokens * price.usd_per_million_output_tokens
    )
    return tokens / 1e6 + (price.usd_per_image if answer.image_png is not None else 0.0)
