"""Sends one query and collects its replies, or raises the error that says why there is none."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import zenoh

from bus.clock import DeadlineClock
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
_NEVER_S = 24 * 3600.0
"""Timeout given to Zenoh, which counts wall time, where the deadline is not wall time [s]."""

_Arriving = queue.SimpleQueue["zenoh.Reply | None"]
"""Replies as they come; None ends them."""


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
    clock: DeadlineClock,
    others_s: float = _OTHERS_S,
) -> list[zenoh.Reply]:
    """Send one query on the complete ``key`` and return the replies of every session that serves it.

    A queryable may be missing from the routing table of a new session, so the query is repeated for up to 1 s, every
    2 ms because a stop may be waiting. The repeats keep the same number, so a topic that acts, acts once.

    Args:
        question: the encoded payload.
        encoding: its Zenoh encoding.
        timeout_s: how long each reply may take [s].
        signed: the sender, sent along with the query.
        clock: the clock of ``timeout_s`` and ``others_s``.
        others_s: how long further repliers may take after the first reply [s].

    Returns:
        The replies, errors included; empty when no session serves the key.

    Raises:
        BusError: the session is closed.
        TwoAnswers: another session serves the key too, and does not answer within ``others_s``.
        ReplyTimeout: the time is over by a clock other than wall time; Zenoh reports its own timeout as a reply.
    """
    give_up_s = clock.now_s() + min(_ROUTES_S, timeout_s)
    while True:
        arriving, unwanted = _Arriving(), zenoh.CancellationToken()
        try:
            session.get(
                key,
                zenoh.handlers.Callback(arriving.put, lambda: arriving.put(None)),  # noqa: B023 - used in this round only
                payload=question,
                encoding=encoding,
                timeout=_zenohs(timeout_s, clock),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                source_info=signed.source,
                attachment=signed.seal,
                cancellation_token=unwanted,
            )
        except zenoh.ZError as error:
            raise BusError(f"Cannot ask {key}: this connection is closed.", "Open a new one.") from error
        try:
            replies = _collected(arriving, key, timeout_s, others_s, clock)
        except BusError:
            unwanted.cancel()  # type: ignore[no-untyped-call]
            raise
        if replies or clock.now_s() > give_up_s:
            return replies
        time.sleep(_AGAIN_S)


def tokens_on(session: zenoh.Session, key: str, timeout_s: float, clock: DeadlineClock) -> list[zenoh.Reply]:
    """Return the liveliness tokens on ``key``.

    Raises: ReplyTimeout when not all are known within ``timeout_s``: who is not among them may hold one all the same.
    """
    arriving = _Arriving()
    found = zenoh.handlers.Callback(arriving.put, lambda: arriving.put(None))
    session.liveliness().get(key, found, timeout=_zenohs(timeout_s, clock))
    replies: list[zenoh.Reply] = []
    try:
        while (reply := _taken(arriving, _ours(timeout_s, clock), clock)) is not None:
            replies.append(reply)
    except queue.Empty:
        raise timed_out(key.split("/", 2)[-1], timeout_s, clock) from None
    if any(reply.ok is None for reply in replies):
        raise timed_out(key.split("/", 2)[-1], timeout_s, clock)
    return replies


def _zenohs(timeout_s: float, clock: DeadlineClock) -> float:
    """Return the timeout given to Zenoh."""
    return _NEVER_S if clock.is_slowed else timeout_s


def _ours(timeout_s: float, clock: DeadlineClock) -> float | None:
    """Return the timeout that is kept here; None where Zenoh keeps it."""
    return timeout_s if clock.is_slowed else None


def _collected(
    arriving: _Arriving, key: str, timeout_s: float, others_s: float, clock: DeadlineClock
) -> list[zenoh.Reply]:
    """Return the replies up to their end.

    Raises: TwoAnswers when they do not end ``others_s`` after the first; ReplyTimeout.
    """
    replies: list[zenoh.Reply] = []
    while True:
        try:
            reply = _taken(arriving, others_s if replies else _ours(timeout_s, clock), clock)
        except queue.Empty:
            if replies:
                raise _two_answers(f"Another session serves {key!r} too, and lets it wait.") from None
            raise timed_out(key.split("/", 2)[-1], timeout_s, clock) from None
        if reply is None:
            return replies
        replies.append(reply)


def _taken(arriving: _Arriving, limit_s: float | None, clock: DeadlineClock) -> zenoh.Reply | None:
    """Wait for the next reply; None ends them. Raises: Empty after ``limit_s``."""
    if limit_s is None:
        return arriving.get()
    taken: list[zenoh.Reply | None] = []

    def take(seconds: float) -> bool:
        with suppress(queue.Empty):
            taken.append(arriving.get(timeout=seconds))
        return bool(taken)

    if not clock.wait_for(take, limit_s):
        raise queue.Empty
    return taken[0]


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


def samples_in(
    replies: list[zenoh.Reply], root: str, name: str, timeout_s: float, record: Tap, clock: DeadlineClock
) -> list[Sample]:
    """Turn the replies to a query on ``name`` into samples, and record each.

    Args:
        root: prefix of every key of the cell, ``cell/{cell_id}/``.
        name: the query's key below ``root``.
        timeout_s: the query's timeout [s], for the error text.
        record: receives every sample, and the error if one came.
        clock: the clock of ``timeout_s``, for the error text.

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
            raise _error_from(reply.err, lambda: timed_out(name, timeout_s, clock))
        key = str(reply.ok.key_expr).removeprefix(root)
        key = f"{key}/reply" if key == name else key
        samples.append(Sample(key, str(reply.ok.encoding), reply.ok.payload.to_bytes(), replier))
    for one in samples:
        record(one)
    return samples


def timed_out(name: str, timeout_s: float, clock: DeadlineClock) -> ReplyTimeout:
    """Return the error of a query on ``name`` that was not answered; it says when the machine is too busy."""
    return ReplyTimeout(
        f"{name!r} got no answer within {timeout_s:.1f} s.{clock.busy_note()}",
        "Who serves it is busy or frozen: `cell status` shows its loops.",
    )


def _error_from(failure: zenoh.ReplyError | None, late: Callable[[], ReplyTimeout]) -> CellError:
    if failure is None or failure.payload.to_bytes() == b"Timeout":
        return late()
    return error_from_reply(decode(ErrorReply, failure.payload.to_bytes()))
