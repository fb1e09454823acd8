"""Carries errors across the bus: an error raised in a node is raised again, as its own type, in the asking process."""

from __future__ import annotations

from bus import errors
from bus.codes import Code
from bus.commands import ErrorReply
from bus.errors import CellError, CycleFailure, Refused


def error_reply(error: CellError) -> ErrorReply:
    """Return an error of the tree as a message."""
    return ErrorReply(
        state=getattr(error, "state", ""),
        code=error.code,
        reason=error.text,
        advice=error.advice,
        available=getattr(error, "available", ()),
        error=type(error).__name__,
    )


def error_from_reply(reply: ErrorReply) -> CellError:
    """Return the error behind an `ErrorReply`, as its own type where that type takes (text, advice)."""
    kind = getattr(errors, reply.error, CellError)
    if kind is Refused:
        return Refused(reply.reason, reply.advice, code=reply.code, available=reply.available, state=reply.state)
    if kind is CycleFailure:
        return CycleFailure(Code(reply.code), reply.reason)
    error: CellError = kind(reply.reason, reply.advice)
    error.code = reply.code
    return error
