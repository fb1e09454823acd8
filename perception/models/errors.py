"""Why a provider gave no usable answer."""

from __future__ import annotations

from bus.codes import Code
from bus.messages import Usage


class ModelError(Exception):
    """A provider gave no usable answer.

    Attributes:
        code: what kind. ``again``: asking again may help. ``after_s``: not before that, says the server.
        usage: what it counts for it all the same.
    """

    def __init__(
        self, code: Code, text: str, *, again: bool = False, after_s: float = 0.0, usage: Usage | None = None
    ) -> None:
        super().__init__(text)
        self.code, self.text, self.again, self.after_s = code, text, again, after_s
        self.usage = usage or Usage()
