"""The error of a provider that gives no usable answer."""

from __future__ import annotations

from bus.codes import Code
from bus.messages import Usage


class ModelError(Exception):
    """A provider gave no usable answer.

    Attributes:
        code: kind of failure. ``again``: a retry may help. ``after_s``: least wait before it, as the server asks.
        usage: tokens that the provider charges nevertheless.
    """

    def __init__(
        self, code: Code, text: str, *, again: bool = False, after_s: float = 0.0, usage: Usage | None = None
    ) -> None:
        super().__init__(text)
        self.code, self.text, self.again, self.after_s = code, text, again, after_s
        self.usage = usage or Usage()
