"""The goal-image model behind any provider's API: one deadline, bounded retries, a budget, the window shown."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Usage
from bus.redaction import redacted
from config.perception import HostedSettings, PriceSettings
from perception.geometry.window import Window, encode_png
from perception.models.budget import Budget
from perception.models.calls import Call, GivenUp
from perception.models.errors import ModelError
from perception.observed_object import Answer, ObservedObject

_log = logging.getLogger(__name__)

Ask = Callable[[float], Answer]


class Provider(Protocol):
    """One provider's API. Each call ends within ``timeout_s``, and raises ModelError for every failure."""

    name: str

    def complete(self, prompt: str, image_png: bytes | None, timeout_s: float) -> Answer:
        """Return the model's text for a prompt and, optionally, an image, within ``timeout_s``."""

    def edit(self, image_png: bytes, keep_png: bytes, prompt: str, timeout_s: float) -> Answer:
        """Return the image redrawn, within ``timeout_s``.

        Args:
            keep_png: RGBA of the image's size, opaque where it must not change.
        """

    def close(self) -> None:
        """Release connections."""


class HostedModel:
    """A goal-image model behind a provider's API.

    Args:
        clock: monotonic [s].
    """

    def __init__(
        self, provider: Provider, settings: HostedSettings, budget: Budget, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.name, self.is_hosted = provider.name, True
        self._provider, self._settings, self._budget, self._clock = provider, settings, budget, clock
        self._left_behind: list[Call[Answer]] = []

    def begin(self) -> None:
        """Begin a cycle; its cost is counted from zero."""
        self._budget.begin()

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        """Return the place of the target, as text, in the image (H, W, 3) padded to a square. Raises: CycleFailure."""
        side = max(color.shape[:2])
        png = encode_png(Window(0, 0, side).cut(color, 0), self._settings.size_px)
        return self._call(lambda timeout_s: self._provider.complete(prompt, png, timeout_s), cancel)

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Place and direction of a grasp, as text. Raises: CycleFailure."""
        png = self._shown(observed_object)
        return self._call(lambda timeout_s: self._provider.complete(prompt, png, timeout_s), cancel)

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """One self-contained editing instruction. Raises: CycleFailure."""
        return self._call(lambda timeout_s: self._provider.complete(prompt, None, timeout_s), cancel)

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        """Return the goal image as a picture of the window. Raises: CycleFailure."""
        window = Window.around(observed_object.mask)
        kept = window.cut(observed_object.mask.astype(np.uint8) * 255, 0)
        keep_png = encode_png(np.dstack([kept, kept, kept, kept]), self._settings.size_px)
        png = self._shown(observed_object)
        return self._call(lambda timeout_s: self._provider.edit(png, keep_png, prompt, timeout_s), cancel)

    def close(self) -> None:
        """Close the provider; warn of calls that are still running, because their cost is unknown."""
        open_calls = sum(not call.is_over for call in self._left_behind)
        if open_calls:
            _log.warning(
                "%s: %d calls that were given up have not ended; their cost is unknown.", self.name, open_calls
            )
        self._provider.close()

    def _shown(self, observed_object: ObservedObject) -> bytes:
        window = Window.around(observed_object.mask)
        return encode_png(window.cut(observed_object.masked, observed_object.background), self._settings.size_px)

    # --- asking -------------------------------------------------------------------------------------------------------

    def _call(self, ask: Ask, cancel: Cancel) -> Answer:
        """Ask until there is an answer, the attempts are used up, or the deadline is too near.

        Raises: CycleFailure: SPEND_LIMIT, STOPPED, or the last attempt's code.
        """
        # Read the cycle before checking for a stop: the next cycle begins only after this one was stopped.
        cycle, settings = self._budget.cycle, self._settings
        cancel.raise_if_set("detect")
        end_s = self._clock() + settings.deadline_s
        for attempt in range(1, settings.attempts + 1):
            self._budget.require()
            try:
                return replace(self._attempt(ask, end_s, cycle, cancel), attempts=attempt)
            except ModelError as fault:
                wait_s = max(settings.backoff_s * 2 ** (attempt - 1), fault.after_s)
                if not fault.again or attempt == settings.attempts or self._clock() + wait_s >= end_s:
                    asked = f" Asked {attempt} times." if attempt > 1 else ""
                    raise CycleFailure(fault.code, f"{self.name}: {fault.text}{asked}") from None
                if cancel.wait(wait_s):
                    what = f"{self.name}: given up by a stop, before attempt {attempt + 1}: {fault.text}"
                    raise CycleFailure(Code.STOPPED, what) from None
        raise AssertionError("at least one attempt is made")

    def _attempt(self, ask: Ask, end_s: float, cycle: int, cancel: Cancel) -> Answer:
        """Make one request. After a stop the request runs on to its end.

        Raises: ModelError; CycleFailure(STOPPED).
        """
        left_s, began = end_s - self._clock(), self._budget.now()

        def work() -> Answer:
            try:
                answer = ask(left_s)
            except ModelError as fault:
                self._budget.pay(self.name, self._cost_usd(fault.usage), cycle, began)
                raise
            cost_usd = self._cost_usd(answer.usage, pictures=answer.image_png is not None)
            self._budget.pay(self.name, cost_usd, cycle, began)
            return replace(answer, usage=answer.usage.model_copy(update={"cost_usd": cost_usd}))

        call = Call(work, self._tell_late, of=self.name)
        try:
            return call.wait(left_s, cancel)
        except GivenUp:
            self._left_behind = [one for one in self._left_behind if not one.is_over] + [call]
            if cancel.is_set:
                raise CycleFailure(Code.STOPPED, f"{self.name}: given up by a stop, before it answered.") from None
            raise ModelError(Code.MODEL_TIMEOUT, "It did not answer in time.", again=True) from None

    def _cost_usd(self, usage: Usage, *, pictures: bool = False) -> float:
        price: PriceSettings = self._settings.price
        if not usage.is_complete:
            _log.warning("%s does not tell all tokens it used: only those it tells are paid for here.", self.name)
        tokens = (
            usage.input_tokens * price.usd_per_million_input_tokens
            + usage.output_tokens * price.usd_per_million_output_tokens
        )
        return tokens / 1e6 + pictures * price.usd_per_image

    def _tell_late(self, outcome: Answer | BaseException) -> None:
        """Log the outcome of a request that was given up; its cost is already charged to its cycle."""
        if isinstance(outcome, Answer):
            _log.warning("%s: a call that was given up has cost %.4f USD.", self.name, outcome.usage.cost_usd)
        else:
            _log.warning("%s: a call that was given up ended without an answer: %s", self.name, redacted(str(outcome)))
