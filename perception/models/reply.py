"""Reads providers' replies: checks every field, and returns a value or raises ModelError.

Every extracted text is free of secrets (`bus.redaction`) and can be encoded.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
from typing import Any

from bus.codes import Code
from bus.messages import Usage
from bus.redaction import holds_secret, quoted, redacted
from perception.models.errors import ModelError
from perception.models.exchange import Reply

_BLOCKED = ("moderation_blocked", "content_policy_violation", "content_filter", "ResponsibleAIPolicyViolation")
_OUT_OF_CREDIT = ("insufficient_quota", "billing_hard_limit_reached")
_BAD_KEY = "API_KEY_INVALID"
_MOST_TOKENS = 10**9
_SECONDS = re.compile(r"\s*([0-9]{1,6}(?:\.[0-9]{0,6})?)\s*s?\s*", re.ASCII)
_DATA_URL = re.compile(r"data:[^,;]*(?:;[^,;]*)*;base64,", re.ASCII | re.IGNORECASE)


# --- fields -----------------------------------------------------------------------------------------------------------


def member(value: object, *path: str | int) -> Any:
    """Return the value at ``path`` in parsed JSON; None when there is none. An int in ``path`` indexes a list."""
    for step in path:
        if isinstance(step, str) and isinstance(value, dict):
            value = value.get(step)
        elif isinstance(step, int) and isinstance(value, list) and len(value) > step:
            value = value[step]
        else:
            return None
    return value


def entries(value: object) -> list[Any]:
    """Return the entries of a list; an empty list for anything else."""
    return value if isinstance(value, list) else []


def words(value: object) -> str:
    """A text without secrets and lone surrogates; "" for anything else."""
    return redacted(value.encode("utf-8", "replace").decode("utf-8")) if isinstance(value, str) else ""


def raw(value: object) -> str:
    """A text unchanged, for a picture's base64; "" for anything else."""
    return value if isinstance(value, str) else ""


def usage_of(asked: object, answered: object, reasoning: object = 0) -> Usage:
    """Tokens as the provider counts them; missing counts are 0, and the usage is marked incomplete."""
    known = [_count(one) for one in (asked, answered, reasoning)]
    return Usage(
        input_tokens=known[0] or 0,
        output_tokens=known[1] or 0,
        reasoning_tokens=known[2] or 0,
        is_complete=None not in known[:2],
    )


def _count(value: object) -> int | None:
    """A number of tokens; None for an invalid one."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return int(value) if math.isfinite(value) and 0 <= value <= _MOST_TOKENS else None


def picture(drawn: str, usage: Usage) -> bytes:
    """Return the bytes of a picture in base64: either alphabet, with line breaks, or as a data URL.

    Raises: ModelError(MODEL_BAD_IMAGE), also for a file that contains a secret, e.g. in a comment.
    """
    text = "".join(_DATA_URL.sub("", drawn.strip(), count=1).split()).rstrip("=")
    try:
        standard = text.replace("-", "+").replace("_", "/") + "=" * (-len(text) % 4)
        data = base64.b64decode(standard.encode("ascii"), validate=True)
    except (binascii.Error, UnicodeEncodeError):
        what = f"The picture is no base64 text: {quoted(drawn, 60)}"
        raise ModelError(Code.MODEL_BAD_IMAGE, what, usage=usage) from None
    if holds_secret(data):
        raise ModelError(Code.MODEL_BAD_IMAGE, "The picture's file holds the key, and is not kept.", usage=usage)
    return data


# --- replies ----------------------------------------------------------------------------------------------------------


def parsed(reply: Reply) -> dict[str, Any]:
    """Return the JSON object of a successful reply. Raises: ModelError for every other reply, quoting it."""
    body = _json(reply.body)
    if not 200 <= reply.status < 300:
        raise _fault_of_status(reply, body, reply.status)
    if not isinstance(body, dict):
        raise unreadable(reply, "is no JSON object")
    if body.get("error"):
        raise _fault_of_error(reply, body)
    return body


def unreadable(reply: Reply, why: str, usage: Usage | None = None) -> ModelError:
    """MODEL_UNAVAILABLE with the reply quoted; ``why`` follows "Its answer"."""
    return ModelError(Code.MODEL_UNAVAILABLE, f"Its answer {why}: {quote_of(reply)}", usage=usage)


def refused(reply: Reply, why: str, usage: Usage) -> ModelError:
    """MODEL_REFUSED with the reason the provider gave, or the whole reply where it gave none."""
    reason = quoted(why, 1000) or f"it said nothing in {quote_of(reply)}"
    return ModelError(Code.MODEL_REFUSED, f"It refused: {reason}", usage=usage)


def _json(data: bytes) -> object:
    """The parsed JSON, or None."""
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None


def quote_of(reply: Reply) -> str:
    """Return the reply, shortened; JSON is unescaped, so that no secret is hidden by escapes."""
    body = _json(reply.body)
    text = reply.body[:4000].decode("utf-8", "replace") if body is None else json.dumps(body, ensure_ascii=False)
    return quoted(text) or "nothing"


def _message(body: object, reply: Reply) -> str:
    """The message of an error of any known form."""
    error = member(body, "error")
    said = next((text for text in (error, member(error, "message"), member(body, "message")) if words(text)), None)
    return quoted(said, 500) if isinstance(said, str) else quote_of(reply)


def _fault_of_error(reply: Reply, body: dict[str, Any]) -> ModelError:
    """The ModelError for an error in a reply with a success status; some proxies put the status into the body."""
    code = member(body, "error", "code")
    if isinstance(code, int) and 400 <= code < 600:
        return _fault_of_status(reply, body, code)
    kind = Code.MODEL_REFUSED if code in _BLOCKED else Code.MODEL_UNAVAILABLE
    return ModelError(kind, f"It answered with an error: {_message(body, reply)}")


def _fault_of_status(reply: Reply, body: object, status: int) -> ModelError:
    if isinstance(body, list) and len(body) == 1:  # Google's errors through some proxies
        body = body[0]
    code = member(body, "error", "code")
    what = f"{_message(body, reply)} (HTTP {status})"
    if status == 429:
        out = code in _OUT_OF_CREDIT or member(body, "error", "type") in _OUT_OF_CREDIT
        return ModelError(Code.MODEL_QUOTA, what, again=not out, after_s=_after_s(reply, body))
    reasons = [member(detail, "reason") for detail in entries(member(body, "error", "details"))]
    if status in (401, 403, 404) or _BAD_KEY in reasons:
        return ModelError(Code.MODEL_ACCESS, what)
    if status in (408, 409, 425) or status >= 500:
        return ModelError(Code.MODEL_UNAVAILABLE, what, again=True, after_s=_after_s(reply, body))
    if status < 400:
        return ModelError(Code.MODEL_UNAVAILABLE, f"Its answer is none: {what}")
    blocked = code in _BLOCKED or member(body, "error", "innererror", "code") in _BLOCKED
    return ModelError(Code.MODEL_REFUSED, ("It refused: " if blocked else "It did not take the request: ") + what)


def _after_s(reply: Reply, body: object) -> float:
    """The wait [s] that the server asks for, in its header or in the body's details; 0 for a date or nothing."""
    asked = [reply.headers.get("retry-after")]
    asked += [member(detail, "retryDelay") for detail in entries(member(body, "error", "details"))]
    found = [_SECONDS.fullmatch(text) for text in asked if isinstance(text, str)]
    return max((float(match.group(1)) for match in found if match is not None), default=0.0)
