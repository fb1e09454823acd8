"""Answers one query with its handler's result, or with the error the handler raised. Every query gets an answer."""

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
"""Longer queries are answered but not recorded; the cell's own commands have some hundred bytes."""

_REMEMBERED, _NUMBERS = 4, 1024
"""How many answers and how many query numbers are kept: answers may be large, numbers are small."""


class Answers:
    """The recent answers of one topic: a query that is sent again gets the same answer, and acts once."""

    def __init__(self) -> None:
        self._by_question: OrderedDict[tuple[str, int], Sequence[Sample]] = OrderedDict()
        self._acted: deque[tuple[str, int]] = deque(maxlen=_NUMBERS)

    def known(self, question: Asked) -> Sequence[Sample] | None:
        """Return the kept answer to this query; None when it is new, too old, or names no source session."""
        return self._by_question.get((question.source, question.number)) if question.source else None

    def is_old(self, question: Asked) -> bool:
        """Whether the query was acted on already; when `known` has no answer either, it is a late copy."""
        return question.source != "" and (question.source, question.number) in self._acted

    def keep(self, question: Asked, answer: Sequence[Sample]) -> None:
        """Remember the answer by the query's session and number; the oldest answer beyond four is dropped."""
        if not question.source:  # without a source there is no number; the handler goes by the payload's command_id
            return
        self._acted.append((question.source, question.number))
        self._by_question[question.source, question.number] = answer
        while len(self._by_question) > _REMEMBERED:
            self._by_question.popitem(last=False)


def reply_to(
    query: zenoh.Query, question: Asked, topic: Topic, key: str, handler: Handler, record: Tap, answers: Answers
) -> None:
    """Call ``handler`` and reply with its result; query and answer are recorded together.

    A `CellError` is sent as a typed error. Any other exception is a defect: it is sent as ``INTERNAL`` and raised.

    Args:
        query: the Zenoh query that gets the reply.
        question: the facts about it (`bus.access.asked`).
        key: the served key, complete; a final chunk ``*`` stands for the query's last chunk.
        record: receives the query and every part of the answer, where the topic is logged.
        answers: the recent answers of this topic; used for topics that only the cell may ask.
    """
    key = key.removesuffix("*") + question.verb if key.endswith("*") else key  # the query's own key may be a pattern
    root, name = key[: -len(_short(key))], _short(key)
    is_kept = topic.acts == "cell"  # a client's command is told apart by its command_id instead
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
    """Return the query's payload as bytes; a query without content means an empty JSON object."""
    return (query.payload.to_bytes() if query.payload is not None else b"") or b"{}"


def refuse(query: zenoh.Query, why: Refused) -> None:
    """Answer with a refusal and record nothing, because the cell does nothing for this query."""
    query.reply_err(encode(error_reply(why)), encoding=AS_ERROR)


def _answer(handler: Handler, payload: bytes, question: Asked, name: str) -> list[Sample]:
    """Call the handler and return the payloads to reply with.

    Raises: BadPayload when the payload is too large or the client cannot take several keys; what the handler raises.
    """
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
    """Return the key without the cell's root ``cell/{cell_id}/``."""
    return key.split("/", 2)[2]


def _record(record: Tap, topic: Topic, name: str, question: bytes, answer: Sequence[Sample]) -> None:
    """Record the query and its answer, where the topic is logged; an overlong query is not kept."""
    if topic.logged and len(question) <= MAX_RECORDED_QUESTION_BYTES:
        record(Sample(f"{name}/query", encoding_of(topic.asks), question))
        for part in answer:
            record(part._replace(key=f"{name}/reply") if part.key == name else part)


def _defect(error: Exception) -> ErrorReply:
    reason = f"{type(error).__name__}: {str(error).rstrip('.')}."
    return ErrorReply(code="INTERNAL", reason=reason, advice="This is a defect: please report it.")
