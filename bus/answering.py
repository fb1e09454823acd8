"""Answers one question: with what its handler returns, or with the error it raised. No question stays unanswered."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Sequence

import zenoh

from bus.asking import AS_ERROR
from bus.codec import encode
from bus.commands import ErrorReply
from bus.errors import BadPayload, CellError, Refused
from bus.frozen import Message
from bus.remote_errors import error_reply
from bus.sample import Asked, Handler, Sample, Tap
from bus.secured import MAX_PAYLOAD_BYTES
from bus.topics import Topic, encoding_of

MAX_RECORDED_QUESTION_BYTES = 64 * 1024
"""Longer questions to a cell that records are a stranger's; its commands have some hundred bytes."""

_REMEMBERED, _NUMBERS = 4, 1024
"""Answers may be large, numbers are not."""


class Answers:
    """What a device answered on one topic: a question that is asked again is answered again, and acts once."""

    def __init__(self) -> None:
        self._by_question: OrderedDict[tuple[str, int], Sequence[Sample]] = OrderedDict()
        self._acted: deque[tuple[str, int]] = deque(maxlen=_NUMBERS)

    def known(self, question: Asked) -> Sequence[Sample] | None:
        """The answer to this very question, if it was given lately."""
        return self._by_question.get((question.source, question.number)) if question.source else None

    def is_old(self, question: Asked) -> bool:
        """Whether it was acted on some time ago: a copy of it, not the question asked again at once."""
        return question.source != "" and (question.source, question.number) in self._acted

    def keep(self, question: Asked, answer: Sequence[Sample]) -> None:
        if not question.source:  # it names no number: its handler must tell by the payload (command_id)
            return
        self._acted.append((question.source, question.number))
        self._by_question[question.source, question.number] = answer
        while len(self._by_question) > _REMEMBERED:
            self._by_question.popitem(last=False)


def reply_to(
    query: zenoh.Query, question: Asked, topic: Topic, key: str, handler: Handler, record: Tap, answers: Answers
) -> None:
    """Ask ``handler`` and reply; the question and what was said are recorded together, then.

    Args:
        key: what is served, a whole key; its last chunk may be ``*``, and is then the question's.

    A defect of the handler is answered too, and raised on.
    """
    key = key.removesuffix("*") + question.verb if key.endswith("*") else key  # the question's may be a pattern
    root, name = key[: -len(_short(key))], _short(key)
    is_kept = topic.acts == "cell"  # a command has an id of its own
    known = answers.known(question) if is_kept else None
    if known is not None:
        _send(query, root, known)
        return
    if is_kept and answers.is_old(question):
        refuse(query, Refused(f"{name!r} has acted on this question before.", "Ask anew.", code="REPEATED"))
        return
    payload = payload_of(query)
    try:
        answer = _answer(handler, payload, question, name)
    except CellError as error:
        answer = [Sample(f"{name}/error", AS_ERROR, encode(error_reply(error)))]
    except Exception as defect:
        query.reply_err(encode(_defect(defect)), encoding=AS_ERROR)
        raise
    _record(record, topic, name, payload, answer)
    if is_kept:
        answers.keep(question, answer)
    _send(query, root, answer)


def payload_of(query: zenoh.Query) -> bytes:
    """What a question brings; a question without content means an empty object."""
    return (query.payload.to_bytes() if query.payload is not None else b"") or b"{}"


def refuse(query: zenoh.Query, why: Refused) -> None:
    """Answer with a refusal, and record nothing: it asked for nothing that this cell does."""
    query.reply_err(encode(error_reply(why)), encoding=AS_ERROR)


def _answer(handler: Handler, payload: bytes, question: Asked, name: str) -> list[Sample]:
    """Raises: BadPayload for a question too large, or whose asker cannot take the answer; what the handler raises."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise BadPayload(f"The payload has {len(payload)} bytes; at most {MAX_PAYLOAD_BYTES} are accepted.")
    answer = handler(payload, question)
    if isinstance(answer, Message):
        return [Sample(name, encoding_of(type(answer)), encode(answer))]
    if not question.takes_any_key:
        raise BadPayload(f"{name!r} is answered on several keys.", "Ask with accept_replies = ANY.")
    return answer


def _send(query: zenoh.Query, root: str, answer: Sequence[Sample]) -> None:
    for part in answer:
        if part.encoding == AS_ERROR:
            query.reply_err(part.payload, encoding=AS_ERROR)
        else:
            query.reply(f"{root}{part.key}", part.payload, encoding=part.encoding)


def _short(key: str) -> str:
    """Below the cell's root: ``cell/{cell_id}/``."""
    return key.split("/", 2)[2]


def _record(record: Tap, topic: Topic, name: str, question: bytes, answer: Sequence[Sample]) -> None:
    """What we were asked and said. What is far too long is not kept."""
    if topic.logged and len(question) <= MAX_RECORDED_QUESTION_BYTES:
        record(Sample(f"{name}/query", encoding_of(topic.asks), question))
        for part in answer:
            record(part._replace(key=f"{name}/reply") if part.key == name else part)


def _defect(error: Exception) -> ErrorReply:
    return ErrorReply(
        code="INTERNAL", reason=f"{type(error).__name__}: {error}", advice="This is a defect: please report it."
    )
