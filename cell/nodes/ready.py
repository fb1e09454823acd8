"""The first line of a node's child process to its supervisor."""

from __future__ import annotations

from pydantic import Field

from bus.commands import ErrorReply
from bus.frozen import Message


class Ready(Message):
    """The child's first line: ready, or the error that prevents it."""

    node: str
    pid: int = Field(ge=0)
    error: ErrorReply | None = None
