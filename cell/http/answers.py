"""Answers as JSON: a message of the cell, or a refusal, always in the form of an `ErrorReply`."""

from __future__ import annotations

from pydantic import ValidationError
from starlette.responses import Response

from bus.codec import encode
from bus.commands import ErrorReply
from bus.errors import BadPayload, BusError, CellError, RecordingError, Refused, ReplyTimeout
from bus.first_mistake import first_mistake
from bus.frozen import Message
from bus.remote_errors import error_reply

JSON = "application/json"
_REFUSED = {"NO_RIGHT": 403, "TOO_MANY": 503} | dict.fromkeys(
    ("NO_RESULT", "UNKNOWN_COMMAND", "NO_PICTURE", "NO_PROPOSAL", "NO_PLAN"), 404
)
_STATUS: tuple[tuple[type[CellError], int], ...] = (
    (BadPayload, 422),
    (ReplyTimeout, 504),
    (BusError, 503),
    (RecordingError, 404),
)


def say(message: Message, status: int = 200) -> Response:
    """Return the answer with one message."""
    return Response(encode(message), status, media_type=JSON)


def refuse(status: int, code: str, reason: str, advice: str = "", available: tuple[str, ...] = ()) -> Response:
    """Return the answer that refuses a request."""
    return say(ErrorReply(code=code, reason=reason, advice=advice, available=available, error="Refused"), status)


def answer_error(error: CellError) -> Response:
    """Answer an error of the tree: 409 what the cell refused, 422 what cannot be read, 503 without a cell."""
    return say(error_reply(error), status_of(error))


def status_of(error: CellError) -> int:
    """Return the HTTP status of an error."""
    if isinstance(error, Refused):
        return _REFUSED.get(error.code, 409)
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 409)


def bad_value(error: ValidationError) -> BadPayload:
    """Return the error for a value of a request that does not fit; it names the field."""
    return BadPayload(f"{first_mistake(error, whole='request')}.", "The fields: GET /api/openapi.json.")
