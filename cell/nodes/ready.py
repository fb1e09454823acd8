"""The first line of a child process to the cell: of a node, or of a door."""

from __future__ import annotations

from pydantic import Field

from bus.commands import ErrorReply
from bus.frozen import Message


class Ready(Message):
    """The child's first line: ready, or the error that prevents it."""

    node: str
    pid: int = Field(ge=0)
    error: ErrorReply | None = None


class Open(Message):
    """The first line of a door's process: where other programs reach it, or the error that keeps it closed."""

    endpoint: str = ""
    pid: int = Field(ge=0)
    error: ErrorReply | None = None
