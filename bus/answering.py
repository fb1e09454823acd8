"""Answers one question: with what its handler returns, or with the error it raised. No question stays unanswered."""

from __future__ import annotations

import re

import zenoh

from bus.asking import AS_ERROR
from bus.codec import encode
from bus.commands import ErrorReply
from bus.errors import BadPayload, CellError
from bus.frozen import Message
from bus.heard import Handler, Heard, Tap
from bus.remote_errors import error_reply
from bus.secured import MAX_PAYLOAD_BYTES
from bus.topics import Topic, encoding_of

MAX_RECORDED_QUESTION_BYTES = 64 * 1024
"""Longer questions to a cell that records are a stranger's; its commands have some hundred bytes."""

_FIELD = re.compile(r"\{\w+\}")


def reply_to(query: zenoh.Query, topic: Topic, handler: Handler, root: str, record: Tap) -> None:
    """Ask ``handler`` and reply, below ``root``; the question and what was said are recorded together, then.

    A defect of the handler is answered too, and raised on.
    """
    payload = query.payload.to_bytes() if query.payload is not None else b"{}"
    verb = str(query.key_expr).rpartition("/")[2]
    name = _FIELD.sub(verb, topic.key)  # not the question's key: that may be a pattern over many cells
    try:
        if len(payload) > MAX_PAYLOAD_BYTES:
            raise BadPayload(f"The payload has {len(payload)} bytes; at most {MAX_PAYLOAD_BYTES} are accepted.")
        answer = handler(payload, {"verb": verb})
    except CellError as error:
        said = encode(error_reply(error))
        _record(record, topic, name, payload, [Heard(f"{name}/error", AS_ERROR, said)])
        query.reply_err(said, encoding=AS_ERROR)
        return
    except Exception as error:
        query.reply_err(encode(_defect(error)), encoding=AS_ERROR)
        raise
    if isinstance(answer, Message):
        answer = [Heard(name, encoding_of(type(answer)), encode(answer))]
    told = [part._replace(key=f"{name}/reply") if part.key == name else part for part in answer]
    _record(record, topic, name, payload, told)
    for part in answer:
        query.reply(f"{root}{part.key}", part.payload, encoding=part.encoding)


def _record(record: Tap, topic: Topic, name: str, question: bytes, told: list[Heard]) -> None:
    """What we were asked and said. What is far too long is not kept."""
    if topic.logged and len(question) <= MAX_RECORDED_QUESTION_BYTES:
        for heard in (Heard(f"{name}/query", encoding_of(topic.asks), question), *told):
            record(heard)


def _defect(error: Exception) -> ErrorReply:
    text = f"{type(error).__name__}: {error}"
    return ErrorReply(error="CellError", code="INTERNAL", text=text, advice="This is a defect.")
