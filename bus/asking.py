"""Sends one query and collects its replies, or raises the error that says why there is none."""

from __future__ import annotations

import queue
import time
from typing import NamedTuple

import zenoh

from bus.codec import decode
from bus.commands import ErrorReply
from bus.errors import BusError, CellError, ReplyTimeout, TwoAnswers
from bus.remote_errors import error_from_reply
from bus.sample import Sample, Tap
from bus.topics import encoding_of

AS_ERROR = encoding_of(ErrorReply)  # a timeout has another encoding: Zenoh itself reports it
_ROUTES_S, _AGAIN_S = 1.0, 0.002
_OTHERS_S = 2.0
"""Wait for other repliers [s]. A lone replier ends with its last reply; a frozen one is gone after its lease (1 s)."""


class Signed(NamedTuple):
    """Identifies the sender of a sample or query: its session, a number used once, and its seal (`bus.seal`).

    Attributes:
        source: Zenoh session and number.
        seal: None where this process shares no secret with the cell.
    """

    source: zenoh.SourceInfo
    seal: bytes | None


def replies_to(
    session: zenoh.Session,
    key: str,
    question: bytes,
    encoding: str,
    timeout_s: float,
    signed: Signed,
    others_s: float = _OTHERS_S,
) -> list[zenoh.Reply]:
    """Send one query on the complete ``key`` and return the replies of every session that serves it.

    A queryable may be missing from the routing table of a new session, so the query is repeated for up to 1 s, every
    2 ms because a stop may be waiting. The repeats keep the same number, so a topic that acts, acts once.

    Args:
        question: the encoded payload.
        encoding: its Zenoh encoding.
        timeout_s: how long Zenoh waits for each reply [s].
        signed: the sender, sent along with the query.
        others_s: how long further repliers may take after the first reply [s].

    Returns:
        The replies, errors included; empty when no session serves the key.

    Raises:
        BusError: the session is closed.
        TwoAnswers: another session serves the key too, and does not answer within ``others_s``.
    """
    give_up_s = time.monotonic() + min(_ROUTES_S, timeout_s)
    while True:
        arriving: queue.SimpleQueue[zenoh.Reply | None] = queue.SimpleQueue()  # None ends the replies
        try:
            session.get(
                key,
                zenoh.handlers.Callback(arriving.put, lambda: arriving.put(None)),  # noqa: B023 - used in this round only
                payload=question,
                encoding=encoding,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                source_info=signed.source,
                attachment=signed.seal,
            )
        except zenoh.ZError as error:
            raise BusError(f"Cannot ask {key}: the bus is closed.") from error
        replies = _collected(arriving, key, others_s)
        if replies or time.monotonic() > give_up_s:
            return replies
        time.sleep(_AGAIN_S)


def _collected(arriving: queue.SimpleQueue[zenoh.Reply | None], key: str, others_s: float) -> list[zenoh.Reply]:
    """Return the replies up to their end. Raises: TwoAnswers when they do not end ``others_s`` after the first."""
    replies: list[zenoh.Reply] = []
    while True:
        try:
            reply = arriving.get(timeout=others_s if replies else None)
        except queue.Empty:
            raise _two_answers(f"Another session serves {key!r} too, and lets it wait.") from None
        if reply is None:
            return replies
        replies.append(reply)


def replier_of(replies: list[zenoh.Reply], name: str) -> str:
    """Return the one session that ``replies`` came from; "" when Zenoh itself timed out. Raises: TwoAnswers."""
    sessions = sorted({str(reply.replier_id.zid) for reply in replies if reply.replier_id is not None})
    if len(sessions) > 1:
        raise _two_answers(f"{len(sessions)} sessions answer {name!r}: {', '.join(one[:8] for one in sessions)}.")
    return sessions[0] if sessions else ""


def _two_answers(text: str) -> TwoAnswers:
    return TwoAnswers(
        f"{text} None of them is believed.",
        "`cell status` names the processes of this cell's nodes: end what answers beside them.",
    )


def samples_in(replies: list[zenoh.Reply], root: str, name: str, timeout_s: float, record: Tap) -> list[Sample]:
    """Turn the replies to a query on ``name`` into samples, and record each.

    Args:
        root: prefix of every key of the cell, ``cell/{cell_id}/``.
        name: the query's key below ``root``.
        timeout_s: the query's timeout [s], for the error text.
        record: receives every sample, and the error if one came.

    Raises:
        CellError: the error that a reply carries, as its own type.
        ReplyTimeout: a reply says that the time is over.
        TwoAnswers: two sessions answered.
    """
    replier = replier_of(replies, name)
    samples = []
    for reply in replies:
        if reply.ok is None:
            if reply.err is not None and str(reply.err.encoding) == AS_ERROR:
                record(Sample(f"{name}/error", AS_ERROR, reply.err.payload.to_bytes()))
            raise _error_from(reply.err, f"{name!r} got no answer within {timeout_s:.1f} s.")
        key = str(reply.ok.key_expr).removeprefix(root)
        key = f"{key}/reply" if key == name else key
        samples.append(Sample(key, str(reply.ok.encoding), reply.ok.payload.to_bytes(), replier))
    for one in samples:
        record(one)
    return samples


def _error_from(failure: zenoh.ReplyError | None, timeout_text: str) -> CellError:
    if failure is None or failure.payload.to_bytes() == b"Timeout":
        return ReplyTimeout(timeout_text, "Who serves it is busy or frozen: `cell status` shows its loops.")
    return error_from_reply(decode(ErrorReply, failure.payload.to_bytes()))
